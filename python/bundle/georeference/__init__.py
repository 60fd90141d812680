"""Georeferencing: coordinates on the earth, measured positions, and alignment to them."""

from __future__ import annotations

from bundle.base.public_modules import deferred

_DEFERRED = {
    "alignment": "align",
    "alignment_result": "Alignment ControlPointError ImageError",
    "attitudes": "AttitudeErrors Attitudes read_attitudes",
    "control_point": "GroundControlPoint Measurement ScaleBar",
    "exif_gps": "read_exif_gps",
    "gcp_list": "read_gcp_list",
    "georeferenced": "Georeference",
    "gps_positions": "GpsPositions read_geo_file",
    "local_frame": "LocalFrame",
    "reference_system": "ReferenceSystem",
    "scale_bars": "ScaleBars read_scale_bars",
    "similarity": "Similarity",
    "survey_priors": "GcpPriors GpsPriors gcp_priors gps_priors",
    "vector_priors": "PositionPrior",
    "velocities": "Velocities VelocityPrior read_velocities",
}
"""Modules with their public names, imported on first use, as in ``bundle/__init__.py``."""
__all__, __getattr__, __dir__ = deferred(__name__, _DEFERRED)
