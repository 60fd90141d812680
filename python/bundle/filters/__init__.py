"""Updates of a filter by tracks of features."""

from bundle.filters.msckf import MsckfUpdate, msckf_update
from bundle.filters.track_linearization import TrackRows, track_rows

__all__ = ["MsckfUpdate", "TrackRows", "msckf_update", "track_rows"]
