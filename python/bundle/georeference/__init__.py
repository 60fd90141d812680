"""Georeferencing: coordinates on the earth, measured positions, and alignment to them."""

from bundle.georeference.alignment import align
from bundle.georeference.alignment_result import Alignment, ControlPointError, ImageError
from bundle.georeference.attitudes import AttitudeErrors, Attitudes, read_attitudes
from bundle.georeference.control_point import GroundControlPoint, Measurement
from bundle.georeference.exif_gps import read_exif_gps
from bundle.georeference.gcp_list import read_gcp_list
from bundle.georeference.georeferenced import Georeference
from bundle.georeference.gps_positions import GpsPositions, read_geo_file
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.reference_system import ReferenceSystem
from bundle.georeference.similarity import Similarity
from bundle.georeference.survey_priors import GcpPriors, GpsPriors, gcp_priors, gps_priors
from bundle.georeference.vector_priors import PositionPrior, VelocityPrior
from bundle.georeference.velocities import Velocities, read_velocities

__all__ = [
    "Alignment",
    "AttitudeErrors",
    "Attitudes",
    "ControlPointError",
    "GcpPriors",
    "Georeference",
    "GpsPositions",
    "GpsPriors",
    "GroundControlPoint",
    "ImageError",
    "LocalFrame",
    "Measurement",
    "PositionPrior",
    "ReferenceSystem",
    "Similarity",
    "Velocities",
    "VelocityPrior",
    "align",
    "gcp_priors",
    "gps_priors",
    "read_attitudes",
    "read_exif_gps",
    "read_gcp_list",
    "read_geo_file",
    "read_velocities",
]
