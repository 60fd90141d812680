"""pycolmap's objects of a bundle adjustment: options, configuration, summary, changes in place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pycolmap
from numpy.typing import NDArray
from pycolmap import (
    BundleAdjustmentConfig,
    BundleAdjustmentOptions,
    BundleAdjustmentSummary,
    Reconstruction,
)

from bundle.base.arrays import check_type
from bundle.base.records import dataclass
from bundle.errors import InputError

if TYPE_CHECKING:
    from bundle.model.problem import Problem

__all__ = [
    "AdjustmentConfig",
    "BundleAdjustmentConfig",
    "BundleAdjustmentOptions",
    "BundleAdjustmentSummary",
    "Reconstruction",
    "config_of",
    "empty_summary",
    "options_of",
    "summary_of",
]


@dataclass(frozen=True, kw_only=True)
class AdjustmentConfig:
    """Content of a ``pycolmap.BundleAdjustmentConfig``, all as ids.

    Attributes:
        images: images whose observations take part.
        variable_points: points all of whose observations take part.
        constant_points: as ``variable_points``, and constant.
        constant_cameras: cameras with constant intrinsics.
        constant_sensors: cameras with a constant pose on their rig.
        constant_frames: frames with a constant pose.
        gauge: name of the gauge in :class:`bundle.SolveOptions`.
    """

    images: frozenset[int]
    variable_points: frozenset[int] = frozenset()
    constant_points: frozenset[int] = frozenset()
    constant_cameras: frozenset[int] = frozenset()
    constant_sensors: frozenset[int] = frozenset()
    constant_frames: frozenset[int] = frozenset()
    gauge: str


_GAUGES = {
    "UNSPECIFIED": "none",
    "TWO_CAMS_FROM_WORLD": "two_cameras",
    "THREE_POINTS": "three_points",
}


def config_of(
    reconstruction: Reconstruction, config: BundleAdjustmentConfig | None
) -> AdjustmentConfig:
    """Return the content of a configuration; None: all images, with the gauge of two cameras.

    Raises:
        InputError: an id is not in the reconstruction, or an image is not registered.
    """
    check_type("reconstruction", reconstruction, Reconstruction)
    registered = frozenset(reconstruction.reg_image_ids())
    if config is None:
        return AdjustmentConfig(images=registered, gauge="two_cameras")
    check_type("config", config, BundleAdjustmentConfig)
    _check_ids("config.images", "registered images", config.images, registered)
    for name in ("variable_points", "constant_points"):
        _check_ids(f"config.{name}", "points", getattr(config, name), reconstruction.points3D)
    return AdjustmentConfig(
        images=frozenset(config.images),
        variable_points=frozenset(config.variable_points),
        constant_points=frozenset(config.constant_points),
        constant_cameras=frozenset(config.constant_cam_intrinsics),
        constant_sensors=frozenset(
            sensor.id
            for sensor in config.constant_sensor_from_rig_poses
            if sensor.type == pycolmap.SensorType.CAMERA
        ),
        constant_frames=frozenset(config.constant_rig_from_world_poses),
        gauge=_GAUGES[config.fixed_gauge.name],
    )


def options_of(
    options: BundleAdjustmentOptions | None,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, str]]:
    """Return the options by name, their defaults, and the attribute of each.

    Names of choices are in lower case. Options of the GPU backend are left out.

    Raises:
        InputError: the options request the GPU backend.
    """
    if options is None:
        options = BundleAdjustmentOptions()
    check_type("options", options, BundleAdjustmentOptions)
    given, places = _flat(options.todict())
    if given.pop("backend", "ceres") != "ceres":
        raise InputError("options.backend: expected CERES, found CASPAR, which needs a GPU")
    defaults, _ = _flat(BundleAdjustmentOptions().todict())
    return given, defaults, places


def summary_of(values: Mapping[str, Any]) -> pycolmap.CeresBundleAdjustmentSummary:
    """Return pycolmap's summary with the values of ours; fields without a value keep -1.

    Args:
        values: fields of :class:`bundle.Summary`, which have Ceres' names.
    """
    summary = pycolmap.CeresBundleAdjustmentSummary()
    ceres = summary.ceres_summary
    for name, before in ceres.todict().items():
        value = values.get(name)
        if value is None:
            continue
        if hasattr(type(before), "__members__"):
            value = type(before).__members__.get(value, before)
        setattr(ceres, name, value)
    # A solve has no constant parameters that count, and its steps have no superfluous numbers.
    ceres.num_effective_parameters = values["num_parameters"]
    ceres.num_effective_parameters_reduced = values["num_parameters_reduced"]
    summary.num_residuals = values["num_residuals_reduced"]
    types = pycolmap.BundleAdjustmentTerminationType.__members__
    summary.termination_type = types[values["termination_type"]]
    return summary


def empty_summary() -> BundleAdjustmentSummary:
    """Return pycolmap's summary of a problem without observations."""
    return BundleAdjustmentSummary()


def _flat(nested: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return values by name, and their attributes, without those of the GPU backend."""
    values: dict[str, Any] = {}
    places: dict[str, str] = {}

    def add(entries: Mapping[str, Any], place: str) -> None:
        for name, value in entries.items():
            if isinstance(value, Mapping):
                if name != "caspar":
                    add(value, f"{place}.{name}")
                continue
            values[name] = value.name.lower() if hasattr(value, "__members__") else value
            places[name] = f"{place}.{name}"

    add(nested, "options")
    return values, places


def _check_ids(place: str, what: str, given: Any, known: Any) -> None:
    for found in sorted(given):
        if found not in known:
            raise InputError(f"{place}: expected {what} of the reconstruction, found {found}")


# Changes of a ``pycolmap.Reconstruction`` in place: refined values, and bad observations.
#
# Only the values of variables are set; images, tracks, colours and all other records stay as they
# are. pycolmap has no arrays of poses or points, so that each value is set alone.

_Mask = NDArray[np.bool_]


def frames_of_images(
    reconstruction: pycolmap.Reconstruction, image_ids: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the frame id of each image."""
    ids = (reconstruction.image(image_id).frame_id for image_id in image_ids.tolist())
    return np.fromiter(ids, np.int64, len(image_ids))


def set_values(
    reconstruction: pycolmap.Reconstruction,
    refined: Problem,
    *,
    images: _Mask,
    points: _Mask,
) -> None:
    """Set the refined values of a sub-problem.

    Args:
        reconstruction: the reconstruction to change.
        refined: the sub-problem with its new values.
        images: mask of its images whose poses are set, each with its frame.
        points: mask of its points that are set.
    """
    for camera_id, model, params in zip(
        refined.camera_ids.tolist(), refined.camera_models, refined.camera_params, strict=True
    ):
        camera = reconstruction.camera(camera_id)
        assert camera.model.name == model
        camera.params = params[: len(camera.params)]
    alone = images if not refined.num_frames else images & (refined.image_frame < 0)
    for row in np.flatnonzero(alone).tolist():
        frame = reconstruction.frame(reconstruction.image(int(refined.image_ids[row])).frame_id)
        frame.rig_from_world = _rigid(refined.cam_from_world[row])
    for frame_id, pose in zip(refined.frame_ids.tolist(), refined.rig_from_world, strict=True):
        reconstruction.frame(frame_id).rig_from_world = _rigid(pose)
    for rig_id, camera_id, pose in zip(
        refined.sensor_rig_ids.tolist(),
        refined.sensor_camera_ids.tolist(),
        refined.sensor_from_rig,
        strict=True,
    ):
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
        reconstruction.rig(rig_id).set_sensor_from_rig(sensor, _rigid(pose))
    rows = np.flatnonzero(points)
    for point_id, xyz in zip(refined.point_ids[rows].tolist(), refined.points[rows], strict=True):
        reconstruction.point3D(point_id).xyz = xyz


def delete_observations_behind(reconstruction: pycolmap.Reconstruction) -> None:
    """Delete observations of points behind their camera, as ``pycolmap.bundle_adjustment`` does."""
    pycolmap.ObservationManager(reconstruction).filter_observations_with_negative_depth()


def update_errors(reconstruction: pycolmap.Reconstruction) -> None:
    """Recompute the reprojection errors that the points hold."""
    reconstruction.update_point_3d_errors()


def _rigid(pose: NDArray[np.float64]) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])
