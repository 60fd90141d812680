"""Where a reconstruction is on the earth: coordinates, measured positions, priors from them."""

from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.reference_system import ReferenceSystem

__all__ = ["LocalFrame", "ReferenceSystem"]
