"""Where a reconstruction is on the earth: coordinates, measured positions, priors from them."""

from bundle.georeference.exif_gps import read_exif_gps
from bundle.georeference.geo_file import read_geo_file
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.gps_priors import Georeference, GpsPriors, gps_priors
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.position_prior import PositionPrior
from bundle.georeference.reference_system import ReferenceSystem
from bundle.georeference.similarity import Similarity

__all__ = [
    "Georeference",
    "GpsPositions",
    "GpsPriors",
    "LocalFrame",
    "PositionPrior",
    "ReferenceSystem",
    "Similarity",
    "gps_priors",
    "read_exif_gps",
    "read_geo_file",
]
