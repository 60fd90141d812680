"""Georeferencing: coordinates on the earth, measured positions, and alignment to them."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_DEFERRED = {
    "alignment": "align",
    "alignment_result": "Alignment ControlPointError ImageError",
    "attitudes": "AttitudeErrors Attitudes read_attitudes",
    "control_point": "GroundControlPoint Measurement",
    "exif_gps": "read_exif_gps",
    "gcp_list": "read_gcp_list",
    "georeferenced": "Georeference",
    "gps_positions": "GpsPositions read_geo_file",
    "local_frame": "LocalFrame",
    "reference_system": "ReferenceSystem",
    "similarity": "Similarity",
    "survey_priors": "GcpPriors GpsPriors gcp_priors gps_priors",
    "vector_priors": "PositionPrior",
    "velocities": "Velocities VelocityPrior read_velocities",
}
"""Modules with their public names, imported on first use, as in ``bundle/__init__.py``."""
_MODULE_OF = {name: module for module, names in _DEFERRED.items() for name in names.split()}

__all__ = sorted(_MODULE_OF)  # noqa: PLE0605 (the stub has a list)


def __getattr__(name: str) -> Any:
    import importlib

    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
