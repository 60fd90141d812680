"""Georeferencing: coordinates on the earth, measured positions, and alignment to them.

Written by tools/public_stub.py; do not edit.
"""

from bundle.georeference.alignment import align as align
from bundle.georeference.alignment_result import Alignment as Alignment
from bundle.georeference.alignment_result import ControlPointError as ControlPointError
from bundle.georeference.alignment_result import ImageError as ImageError
from bundle.georeference.attitudes import AttitudeErrors as AttitudeErrors
from bundle.georeference.attitudes import Attitudes as Attitudes
from bundle.georeference.attitudes import read_attitudes as read_attitudes
from bundle.georeference.control_point import GroundControlPoint as GroundControlPoint
from bundle.georeference.control_point import Measurement as Measurement
from bundle.georeference.control_point import ScaleBar as ScaleBar
from bundle.georeference.exif_gps import read_exif_gps as read_exif_gps
from bundle.georeference.gcp_list import read_gcp_list as read_gcp_list
from bundle.georeference.georeferenced import Georeference as Georeference
from bundle.georeference.gps_positions import GpsPositions as GpsPositions
from bundle.georeference.gps_positions import read_geo_file as read_geo_file
from bundle.georeference.local_frame import LocalFrame as LocalFrame
from bundle.georeference.reference_system import ReferenceSystem as ReferenceSystem
from bundle.georeference.scale_bars import ScaleBars as ScaleBars
from bundle.georeference.scale_bars import read_scale_bars as read_scale_bars
from bundle.georeference.similarity import Similarity as Similarity
from bundle.georeference.survey_priors import GcpPriors as GcpPriors
from bundle.georeference.survey_priors import GpsPriors as GpsPriors
from bundle.georeference.survey_priors import gcp_priors as gcp_priors
from bundle.georeference.survey_priors import gps_priors as gps_priors
from bundle.georeference.vector_priors import PositionPrior as PositionPrior
from bundle.georeference.velocities import Velocities as Velocities
from bundle.georeference.velocities import VelocityPrior as VelocityPrior
from bundle.georeference.velocities import read_velocities as read_velocities

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
    "ScaleBar",
    "ScaleBars",
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
    "read_scale_bars",
    "read_velocities",
]
