"""pycolmap's objects of a bundle adjustment: options, configuration, summary, changes in place."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping
from itertools import repeat
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pycolmap
from numpy.typing import NDArray
from pycolmap import BundleAdjustmentConfig as BundleAdjustmentConfig
from pycolmap import BundleAdjustmentOptions as BundleAdjustmentOptions
from pycolmap import BundleAdjustmentSummary as BundleAdjustmentSummary
from pycolmap import Reconstruction as Reconstruction

from bundle.base.arrays import check_type
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.colmap_options import WITHOUT_INFLUENCE, ColmapAdjustment, colmap_adjustment
from bundle.model.problem_keys import are_in
from bundle.model.pycolmap.reconstruction import (
    Observations,
    check_elements,
    check_lengths,
    fields_of,
    fields_of_images,
    fields_of_some,
    ids_of_points,
    is_valid,
    lengths_of_tracks,
    observations_and_tracks,
    positions_of,
    records_from_objects,
    small_model,
)

if TYPE_CHECKING:
    from bundle.model.problem import Problem


@dataclass(frozen=True, kw_only=True)
class AdjustmentConfig:
    """Content of a ``pycolmap.BundleAdjustmentConfig``, all as ids."""

    images: frozenset[int]  # images whose observations take part
    variable_points: frozenset[int] = frozenset()  # points all of whose observations take part
    constant_points: frozenset[int] = frozenset()  # as ``variable_points``, and constant
    constant_cameras: frozenset[int] = frozenset()  # cameras with constant intrinsics
    constant_sensors: frozenset[int] = frozenset()  # cameras with a constant pose on their rig
    constant_frames: frozenset[int] = frozenset()  # frames with a constant pose
    gauge: str  # name of the gauge in :class:`bundle.SolveOptions`


_GAUGES = {
    "UNSPECIFIED": "none",
    "TWO_CAMS_FROM_WORLD": "two_cameras",
    "THREE_POINTS": "three_points",
}


def config_of(
    reconstruction: Reconstruction, config: BundleAdjustmentConfig | None
) -> AdjustmentConfig:
    """Return the content of a configuration; None: all images, with the gauge of two cameras."""
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


def options_of(options: BundleAdjustmentOptions | None) -> ColmapAdjustment:
    """Translate pycolmap's options; None: its defaults."""
    given = BundleAdjustmentOptions() if options is None else options
    check_type("options", given, BundleAdjustmentOptions)
    return _translated(_values_of(given))


@functools.lru_cache(maxsize=8)
def _translated(given: tuple[Any, ...]) -> ColmapAdjustment:
    """Translate values of all options; cached, because a mapper repeats the same few."""
    places = [f"{owner}.{name}" for owner, names in _option_names().items() for name in names]
    values = _by_place(places, given)
    defaults = _by_place(places, _values_of(BundleAdjustmentOptions()))
    if values.pop("options.backend", "ceres") != "ceres":
        raise InputError("options.backend: expected CERES, found CASPAR, which needs a GPU")
    by_name = {place.rpartition(".")[2]: place for place in values}
    return colmap_adjustment(
        {name: values[place] for name, place in by_name.items()},
        {place.rpartition(".")[2]: value for place, value in defaults.items()},
        lambda name: by_name.get(name, name),
    )


def _values_of(options: BundleAdjustmentOptions) -> tuple[Any, ...]:
    """Return the values of options with influence; ``todict`` of all takes longer."""
    values: tuple[Any, ...] = ()
    for owner, names in _option_names().items():
        values += attrgetter(*names)(functools.reduce(getattr, owner.split(".")[1:], options))
    return values


@functools.cache
def _option_names() -> dict[str, list[str]]:
    """Return the names of options by the object that has them, such as "options.ceres"."""
    found: dict[str, list[str]] = {}

    def walk(owner: str, options: dict[str, Any]) -> None:
        names = options.keys() - WITHOUT_INFLUENCE
        found[owner] = sorted(name for name in names if not isinstance(options[name], dict))
        for name, value in options.items():
            if isinstance(value, dict) and name != "caspar":
                walk(f"{owner}.{name}", value)

    walk("options", BundleAdjustmentOptions().todict())
    return found


def _by_place(places: list[str], values: tuple[Any, ...]) -> dict[str, Any]:
    """Return values by attribute; those of enumerations as names in lower case."""
    return {
        place: value.name.lower() if hasattr(value, "__members__") else value
        for place, value in zip(places, values, strict=True)
    }


def summary_of(
    values: Mapping[str, Any], counts: Mapping[str, int]
) -> pycolmap.CeresBundleAdjustmentSummary:
    """Return pycolmap's summary with the values of ours; fields without a value keep -1.

    ``values``: fields of :class:`bundle.Summary`, which have Ceres' names.
    """
    summary = pycolmap.CeresBundleAdjustmentSummary()
    ceres = summary.ceres_summary
    for name, choices in _summary_fields().items():
        value = counts.get(name, values.get(name))
        if choices:
            value = choices.get(str(value))
        if value is not None:
            setattr(ceres, name, value)
    # A solve has no constant parameters that count, and its steps have no superfluous numbers.
    ceres.num_effective_parameters = values["num_parameters"]
    ceres.num_effective_parameters_reduced = values["num_parameters_reduced"]
    summary.num_residuals = values["num_residuals_reduced"]
    types = pycolmap.BundleAdjustmentTerminationType.__members__
    summary.termination_type = types[values["termination_type"]]
    return summary


@functools.cache
def _summary_fields() -> dict[str, Mapping[str, Any]]:
    """Return the fields of Ceres' summary, each with its choices by name."""
    fields = pycolmap.CeresBundleAdjustmentSummary().ceres_summary.todict()
    return {name: getattr(type(value), "__members__", {}) for name, value in fields.items()}


def _check_ids(place: str, what: str, given: Any, known: Any) -> None:
    for found in sorted(given):
        if found not in known:
            raise InputError(f"{place}: expected {what} of the reconstruction, found {found}")


# Reading of a sub-problem.
#
# Of a large model, only observations of the named images and points are read, with their points,
# images, frames and cameras. Nothing is kept between calls: counts and ids of an edited
# reconstruction may be equal, and a view of a deleted point later shows another one.

_Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AdjustedFields:
    """Sub-problem that a configuration selects."""

    fields: dict[str, Any]  # fields of the problem
    tracks: NDArray[np.int64]  # (num_points,) lengths of the points' tracks in the reconstruction
    frames: NDArray[np.int64]  # (num_images,) frame ids of the images in the reconstruction


def adjusted_fields(
    reconstruction: Reconstruction, config: AdjustmentConfig, min_track_length: int
) -> AdjustedFields:
    """Read the observations of named images and points, without points with shorter tracks."""
    is_whole = len(config.images) == reconstruction.num_reg_images()
    listed = frozenset[int]() if is_whole else config.variable_points | config.constant_points
    most = 0 if is_whole else 3 if listed else 2  # times what is needed: all takes less up to here
    if model := small_model(reconstruction, config.images, most):
        images, found = model  # checked, and in the order of points, images and keypoints
        image, point = found["observation_image"], found["observation_point"]
        xyz, point_ids = found["points"], found["point_ids"]
        taken = are_in(found["image_ids"], config.images)[image]
        taken |= are_in(point_ids, listed)[point]
        tracks = np.bincount(point, minlength=len(point_ids))
        seen = np.bincount(point[taken], minlength=len(point_ids))
        order = np.flatnonzero(taken)
        ids = point_ids.view(np.uint64)
        observations = Observations(images, image, ids[point], found["observation_xy"])
    else:
        observations, elements = observations_and_tracks(
            [reconstruction.image(key) for key in sorted(config.images)],
            list(map(reconstruction.point3D, sorted(listed))),
        )
        if listed:
            elements[:, 2] = ids_of_points(sorted(listed))[elements[:, 2]]
            observations = observations.joined(_outside(reconstruction, config.images, elements))
        order, ids, seen = observations.by_point()
        try:
            points = list(map(reconstruction.point3D, ids.tolist()))
        except IndexError:
            observations.points(ids_of_points(sorted(reconstruction.point3D_ids())))
            raise
        tracks, xyz = lengths_of_tracks(points), positions_of(points)
        point_ids = ids_of_points(ids.tolist())
        are_read = is_whole | are_in(point_ids, listed)
        check_lengths(point_ids, tracks, seen, (seen > tracks) | (are_read & (seen < tracks)))
        if is_whole and not is_valid(reconstruction):
            fields_of(reconstruction)  # names the fault
    used = (tracks >= min_track_length) & (seen > 0)
    observations = observations.taken(order[np.repeat(used, seen)])
    images, seen, tracks = observations.images, seen[used], tracks[used]
    cameras = sorted({image.camera_id for image in images})
    if model and not len(found["rig_from_world"]):
        fields = fields_of_some(found, [image.image_id for image in images], cameras)
    else:
        fields = fields_of_images(reconstruction, images, [*map(reconstruction.camera, cameras)])
    fields |= {
        "points": xyz[used],
        "point_ids": point_ids[used],
        "observation_image": observations.image,
        "observation_point": np.repeat(np.arange(len(seen), dtype=np.int32), seen),
        "observation_xy": observations.xy,
    }
    frames = np.array([image.frame_id for image in images], np.int64)
    return AdjustedFields(fields, tracks, frames)


def _outside(
    reconstruction: Reconstruction, images: frozenset[int], elements: NDArray[np.int64]
) -> Observations:
    """Return the observations of elements (image, keypoint, point) of tracks in other images."""
    rows = elements[~np.isin(elements[:, 0], np.fromiter(images, np.int64, len(images)))]
    rows = rows[np.lexsort(rows.T[::-1])]
    rows = rows[np.append(True, (rows[1:] != rows[:-1]).any(axis=1))[: len(rows)]]
    check_elements(rows, np.isin(rows[:, 0], reconstruction.reg_image_ids()))
    image_ids, image = np.unique(rows[:, 0], return_inverse=True)
    seen_in = list(map(reconstruction.image, image_ids.tolist()))
    counts = np.array([image.num_points2D() for image in seen_in], np.int64)
    check_elements(rows, rows[:, 1] < counts[image])
    seeing = [seen_in[row] for row in image.tolist()]
    found = list(map(pycolmap.Image.point2D, seeing, rows[:, 1].tolist()))
    records = records_from_objects(found)
    check_elements(rows, records["point_id"] == rows[:, 2].astype(np.uint64))
    return Observations(seen_in, image.astype(np.int32), records["point_id"], records["xy"])


# Changes of a ``pycolmap.Reconstruction`` in place: refined values, and bad observations.
#
# Only the values of variables are set; images, tracks, colours and all other records stay as they
# are. pycolmap has no arrays of poses or points, so that each value is set alone.


def set_values(
    reconstruction: pycolmap.Reconstruction,
    refined: Problem,
    *,
    images: _Mask,
    points: _Mask,
) -> None:
    """Set the refined values of a sub-problem.

    ``images``, ``points``: masks of those that are set, images with their frames.
    """
    found = _points_again(reconstruction, refined.point_ids[points].tolist())
    for camera_id, params in zip(refined.camera_ids.tolist(), refined.camera_params, strict=True):
        camera = reconstruction.camera(camera_id)
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
    positions = map(attrgetter("xyz"), found)
    for _ in map(operator.setitem, positions, repeat(...), refined.points[points]):
        pass


def _points_again(
    reconstruction: pycolmap.Reconstruction, ids: list[int]
) -> list[pycolmap.Point3D]:
    """Return points that existed before a solve."""
    try:
        return list(map(reconstruction.point3D, ids))
    except IndexError:
        point_id = next(key for key in ids if not reconstruction.exists_point3D(key))
        raise InputError(
            "reconstruction: expected no changes during the solve, found that point "
            f"{point_id} was deleted"
        ) from None


def delete_observations_behind(reconstruction: pycolmap.Reconstruction) -> None:
    """Delete observations of points behind their camera, as ``pycolmap.bundle_adjustment`` does."""
    pycolmap.ObservationManager(reconstruction).filter_observations_with_negative_depth()


def _rigid(pose: NDArray[np.float64]) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])
