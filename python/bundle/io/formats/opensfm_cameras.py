"""OpenSfM's projection types as camera models, and its rigs as rigs of COLMAP.

Coordinates of OpenSfM are relative to max(width, height), from the centre of the image, x right and
y down: pixels are size * x + width / 2 in COLMAP's convention. p = (X, Y) / Z, r2 = p.p; fisheye
types have p = theta / q (X, Y), with q = |(X, Y)| and theta = atan2(q, Z).

    perspective, simple_radial, radial    p (1 + k1 r2 + k2 r4)             (RADIAL, OPENCV)
    brown             p (1 + k1 r2 + k2 r4 + k3 r6) + tangential            (FULL_OPENCV)
    fisheye           p (1 + k1 r2 + k2 r4)                                 (RADIAL_FISHEYE)
    fisheye_opencv    p (1 + k1 r2 + k2 r4 + k3 r6 + k4 r8)                 (OPENCV_FISHEYE)
    fisheye62         p (1 + k1 r2 + ... + k6 r12) + tangential             (see below)
    fisheye624        the same + (s0 r2 + s1 r4, s2 r2 + s3 r4)             (see below)
    dual              a mixture of perspective and fisheye: l p_1 + (1 - l) p_2     (fitted)
    spherical         (atan2(X, Z), atan2(Y, |(X, Z)|)) / 2 pi              (EQUIRECTANGULAR)

The result is multiplied by the focal lengths, and the principal point is added. tangential =
(2 p1 x y + p2 (r2 + 2 x^2), p1 (r2 + 2 y^2) + 2 p2 x y).

RAD_TAN_THIN_PRISM_FISHEYE (Project Aria's Fisheye624) has the terms of fisheye624, but those after
the radial polynomial act on its result; docs/from_your_tool.md lists the lenses that are the same.

Source: opensfm/src/geometry/camera_projections_functions.h, camera_distortions_functions.h.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.io.formats.file_values import Node
from bundle.io.formats.imported_model import NUM_DIRECTIONS, NUM_RADII, fitted_lens, fitted_to_rays
from bundle.model.rig_arrays import placed, pose_differences
from bundle.model.rigid_motions import inverse_poses, multiply_poses, quaternion_from_vector

Array = NDArray[np.float64]

_TWO_FOCALS = ("focal_x", "focal_y", "c_x", "c_y")
RADIAL = ("k1", "k2", "k3", "k4", "k5", "k6")
PRISM = ("s0", "s1", "s2", "s3")
_PARAMS = {
    "perspective": ("focal", "k1", "k2"),
    "fisheye": ("focal", "k1", "k2"),
    "dual": ("focal", "k1", "k2", "transition"),
    "brown": (*_TWO_FOCALS, "k1", "k2", "p1", "p2", "k3"),
    "radial": (*_TWO_FOCALS, "k1", "k2"),
    "simple_radial": (*_TWO_FOCALS, "k1"),
    "fisheye_opencv": (*_TWO_FOCALS, "k1", "k2", "k3", "k4"),
    "fisheye62": (*_TWO_FOCALS, *RADIAL, "p1", "p2"),
    "fisheye624": (*_TWO_FOCALS, *RADIAL, "p1", "p2", *PRISM),
    "spherical": (),
}
_OLD_NAMES = {"equirectangular": "spherical"}
_WIDEST = {"dual": 1.2, "fisheye62": 2.0, "fisheye624": 2.0}
"""Largest angle to the axis in radians at which a lens is fitted."""


@dataclass(frozen=True)
class SfmCamera:
    """A camera of OpenSfM: its type, size and parameters by name."""

    type: str
    width: int
    height: int
    params: dict[str, float]

    @property
    def size(self) -> int:
        """Pixels per unit."""
        return max(self.width, self.height)


class Camera(NamedTuple):
    """A camera model with its parameters, and the error of a fit in pixels."""

    model: str
    params: Array
    error: float = 0.0


def read_camera(node: Node) -> SfmCamera:
    """Read a camera."""
    given = node.get("projection_type").text()
    kind = _OLD_NAMES.get(given, given)
    if kind not in _PARAMS:
        node.get("projection_type").fail(f"one of {', '.join(_PARAMS)}")
    width, height = (node.get(name).whole() for name in ("width", "height"))
    if not width or not height:
        node.fail("a width and a height above 0")
    params = {name: node.get(name).number() for name in _PARAMS[kind]}
    for name in params:
        if name.startswith("focal") and params[name] <= 0:
            node.get(name).fail("a number above 0")
    return SfmCamera(kind, width, height, params)


def as_model(camera: SfmCamera, place: str) -> Camera:
    """Return the camera model of a camera."""
    p, size = camera.params, camera.size
    if camera.type == "spherical":
        if camera.width != 2 * camera.height:
            raise InputError(
                f"{place}: expected a spherical image twice as wide as high, found "
                f"{camera.width} x {camera.height}"
            )
        return Camera("EQUIRECTANGULAR", np.array([camera.width, camera.height], float))
    middle = np.array([camera.width, camera.height]) / 2
    if "focal" in p:
        base = [p["focal"] * size, *middle]
        if camera.type == "dual":
            return _fitted(camera, middle, place)
        model = "RADIAL" if camera.type == "perspective" else "RADIAL_FISHEYE"
        return Camera(model, np.array([*base, p["k1"], p["k2"]]))
    center = middle + size * np.array([p["c_x"], p["c_y"]])
    base = [p["focal_x"] * size, p["focal_y"] * size, *center]
    if camera.type in ("fisheye62", "fisheye624"):
        return _fisheye624(camera, base, place)
    if camera.type == "fisheye_opencv":
        return Camera("OPENCV_FISHEYE", np.array([*base, p["k1"], p["k2"], p["k3"], p["k4"]]))
    four = [p["k1"], p.get("k2", 0.0), p.get("p1", 0.0), p.get("p2", 0.0)]
    if p.get("k3"):
        return Camera("FULL_OPENCV", np.array([*base, *four, p["k3"], 0, 0, 0]))
    return Camera("OPENCV", np.array([*base, *four]))


def project(camera: SfmCamera, inside: Array) -> Array:
    """Project points (n, 3) in the camera frame by OpenSfM's formula, into its coordinates."""
    p, (x, y, z) = camera.params, inside.T
    if camera.type == "spherical":
        turn = np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        spherical: Array = turn / (2 * np.pi)
        return spherical
    flat = inside[:, :2] / z[:, None]
    radius = np.hypot(x, y)
    angle = np.arctan2(radius, z)
    round_ = inside[:, :2] * np.divide(angle, radius, out=1 / z, where=radius > 0)[:, None]
    if camera.type == "dual":
        uv = p["transition"] * flat + (1 - p["transition"]) * round_
    else:
        uv = round_ if camera.type.startswith("fisheye") else flat
    r2 = (uv * uv).sum(axis=1)
    radial = np.zeros(len(r2))
    for name in reversed(RADIAL):
        radial = r2 * (p.get(name, 0.0) + radial)
    distorted = uv * (1 + radial)[:, None]
    if "s0" in p:
        s0, s1, s2, s3 = (p[name] for name in PRISM)
        distorted += np.column_stack([r2 * (s0 + s1 * r2), r2 * (s2 + s3 * r2)])
    if "p1" in p:
        u, v = uv.T
        distorted[:, 0] += 2 * p["p1"] * u * v + p["p2"] * (r2 + 2 * u * u)
        distorted[:, 1] += p["p1"] * (r2 + 2 * v * v) + 2 * p["p2"] * u * v
    if "focal" in p:
        projected: Array = p["focal"] * distorted
        return projected
    focal, center = np.array([p["focal_x"], p["focal_y"]]), np.array([p["c_x"], p["c_y"]])
    shifted: Array = focal * distorted + center
    return shifted


def _fisheye624(camera: SfmCamera, base: list[float], place: str) -> Camera:
    """Return the exact model of a fisheye62 or fisheye624 lens, or a fitted one.

    ``base``: focal lengths and principal point in pixels.
    """
    p = camera.params
    k = [p[name] for name in RADIAL]
    p1, p2 = p["p1"], p["p2"]
    s0, s1, s2, s3 = (p.get(name, 0.0) for name in PRISM)
    others = [p2, p1, s0, s1, s2, s3]
    if not any(others) and not any(k[4:]):
        return Camera("OPENCV_FISHEYE", np.array([*base, *k[:4]]))
    full = Camera("RAD_TAN_THIN_PRISM_FISHEYE", np.array([*base, *k, *others]))
    if not any(others) or not any(k):
        return full
    if not any([*k[4:], s1, s3]):
        thin = [*base, k[0], k[1], p1, p2, k[2], k[3], s0, s2]
        return Camera("THIN_PRISM_FISHEYE", np.array(thin))
    rays, xy = _rays_inside(camera)
    fit = fitted_to_rays(full.model, (full.model, full.params), rays, xy) if len(rays) else None
    if fit is None:
        raise InputError(f"{place}: expected a lens that {full.model} can represent, found another")
    return Camera(full.model, fit.params, fit.error)


def _rays_inside(camera: SfmCamera) -> tuple[Array, Array]:
    """Return rays of the image on a polar grid, and their pixels.

    The grid ends in each direction where the distance from the axis stops growing.
    """
    angles = np.linspace(0, _WIDEST[camera.type], NUM_RADII + 1)[1:]
    turns = np.arange(2 * NUM_DIRECTIONS) * (np.pi / NUM_DIRECTIONS)
    turn, angle = (grid.ravel() for grid in np.meshgrid(turns, angles, indexing="ij"))
    rays = np.column_stack(
        [np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)]
    )
    projected = project(camera, rays)
    axis = np.array([camera.params["c_x"], camera.params["c_y"]])
    radii = np.linalg.norm(projected - axis, axis=1).reshape(len(turns), len(angles))
    grows = np.logical_and.accumulate(np.diff(radii, axis=1, prepend=0.0) > 0, axis=1)
    half = np.array([camera.width, camera.height]) / 2
    xy = camera.size * projected
    inside = grows.ravel() & (np.abs(xy) <= half).all(axis=1)
    return rays[inside], (xy + half)[inside]


def _fitted(camera: SfmCamera, center: Array, place: str) -> Camera:
    """Fit RADIAL to the rays of a dual camera inside the image."""
    farthest = float(np.hypot(*center)) / camera.size
    angles = np.linspace(0, _WIDEST["dual"], 8 * NUM_RADII + 1)[1:]
    rays = np.column_stack([np.sin(angles), np.zeros(len(angles)), np.cos(angles)])
    radii = project(camera, rays)[:, 0]
    folds = np.diff(radii, prepend=0.0) <= 0
    end = int(np.argmax(folds)) if folds.any() else len(radii)
    inside = np.flatnonzero(radii[:end] <= farthest)
    chosen = inside[:: max(1, len(inside) // NUM_RADII)]
    fit = None
    if len(chosen) > 2:
        focal = camera.params["focal"] * camera.size
        fit = fitted_lens("RADIAL", focal, center, angles[chosen], camera.size * radii[chosen])
    if fit is None:
        raise InputError(f"{place}: expected a lens that RADIAL can represent, found another")
    return Camera("RADIAL", fit.params, fit.error)


# Rigs of OpenSfM as rigs of COLMAP.
#
# OpenSfM has rig cameras, with a pose c_from_instance each, and instances, with a pose
# instance_from_world and one shot per rig camera. In COLMAP a camera is both the lens and the place
# on the rig, and the pose of a rig is that of its reference sensor. Therefore
#
# - each pair of rig camera and lens becomes a camera,
# - rig cameras that occur in one instance form a rig; its reference is the first of them,
# - rig_from_world = reference_from_instance * instance_from_world,
# - sensor_from_rig = sensor_from_instance * reference_from_instance^-1.
#
# An instance of one shot whose rig camera is in no other instance with several shots is an image
# with a pose of its own.

_TOLERANCE = 1e-6


@dataclass(frozen=True)
class RigFields:
    """Fields of the problem that rigs determine."""

    image_camera: NDArray[np.int32]  # (num_images,) camera of each image
    camera: NDArray[np.intp]  # (num_cameras,) camera of the file of each camera
    fields: Mapping[str, Any]  # ``cam_from_world`` and the fields of rigs
    notes: tuple[str, ...] = ()  # sentences about rigs


def rig_fields(
    node: Node, shots: list[str], image_camera: NDArray[np.int32], poses: Array
) -> RigFields:
    """Return the rigs of a reconstruction.

    ``image_camera``: (num_images,) camera of each shot. ``poses``: (num_images, 7) poses of the
    shots.
    """
    num_cameras = int(image_camera.max(initial=-1)) + 1
    declared = len(node.get("cameras").value)
    plain = RigFields(
        image_camera, np.arange(max(num_cameras, declared)), {"cam_from_world": poses}
    )
    members = _members(node, shots)
    if not any(len(instance) > 1 for instance in members.values()):
        return plain
    return _with_rigs(node, members, image_camera, poses, declared)


def _members(node: Node, shots: list[str]) -> dict[str, list[tuple[int, str]]]:
    """Return the shots of each instance: index and name of the rig camera."""
    place = {name: index for index, name in enumerate(shots)}
    found: dict[str, list[tuple[int, str]]] = {}
    for name, instance in (node.find("rig_instances") or Node({}, node.place)).items():
        ids = instance.find("rig_camera_ids")
        if ids is None:
            continue
        found[name] = [(place[shot], rig.text()) for shot, rig in ids.items() if shot in place]
        if len({rig for _, rig in found[name]}) < len(found[name]):
            ids.fail("each rig camera at most once")
    return found


def _pose(node: Node) -> Array:
    rotation, translation = (node.get(name).numbers(3) for name in ("rotation", "translation"))
    if np.abs(rotation).max() > 1e6:
        node.get("rotation").fail("a rotation vector in radians")
    return np.concatenate([quaternion_from_vector(rotation[None])[0], translation])


def _with_rigs(
    node: Node,
    members: dict[str, list[tuple[int, str]]],
    image_camera: NDArray[np.int32],
    poses: Array,
    num_declared: int,
) -> RigFields:
    rig_cameras = node.get("rig_cameras")
    group = _groups(members)
    pairs: dict[tuple[int, str], int] = {}  # lens and rig camera -> camera
    new_camera = image_camera.copy()
    lenses = list(range(num_declared))
    for instance in members.values():
        for image, rig_camera in instance:
            if rig_camera not in group:
                continue
            pair = (int(image_camera[image]), rig_camera)
            if pair not in pairs:
                is_first = all(lens != pair[0] for lens, _ in pairs)
                pairs[pair] = pair[0] if is_first else len(lenses)
                if not is_first:
                    lenses.append(pair[0])
            new_camera[image] = pairs[pair]
    in_group = {image for m in members.values() for image, rig in m if rig in group}
    for image in range(len(image_camera)):  # a lens on a rig and elsewhere: a copy for elsewhere
        if image not in in_group and any(lens == image_camera[image] for lens, _ in pairs):
            pair = (int(image_camera[image]), "")
            if pair not in pairs:
                pairs[pair] = len(lenses)
                lenses.append(pair[0])
            new_camera[image] = pairs[pair]
    arms = {name: _pose(rig_cameras.get(name)) for name in group}
    sensors = {pair: camera for pair, camera in pairs.items() if pair[1] in group}
    reference: dict[int, tuple[int, str]] = {}
    for pair in sensors:
        reference.setdefault(group[pair[1]], pair)
    others = [pair for pair in sensors if pair not in reference.values()]
    frame_poses: list[Array] = []
    frame_rigs: list[int] = []
    frames: list[int] = []
    image_frame = np.full(len(image_camera), -1, np.int32)
    image_sensor = np.full(len(image_camera), -1, np.int32)
    for name, instance in members.items():
        if not any(rig in group for _, rig in instance):
            continue
        rig = group[instance[0][1]]
        own = _pose(node.get("rig_instances").get(name))
        frame_poses.append(_product(arms[reference[rig][1]], own))
        frame_rigs.append(rig)
        frames.append(len(frames))
        for image, rig_camera in instance:
            pair = (int(image_camera[image]), rig_camera)
            image_frame[image] = frames[-1]
            image_sensor[image] = others.index(pair) if pair in others else -1
    back = {rig: inverse_poses(arms[pair[1]][None])[0] for rig, pair in reference.items()}
    from_rig = [_product(arms[pair[1]], back[group[pair[1]]]) for pair in others]
    fields = {
        "rig_from_world": np.array(frame_poses).reshape(-1, 7),
        "frame_ids": np.array(frames, np.int64),
        "frame_rig_ids": np.array(frame_rigs, np.int64),
        "image_frame": image_frame,
        "image_sensor": image_sensor,
        "sensor_from_rig": np.array(from_rig).reshape(-1, 7),
        "sensor_rig_ids": np.array([group[rig] for _, rig in others], np.int64),
        "sensor_camera_ids": np.array([sensors[pair] for pair in others], np.int64),
    }
    placed_poses = placed({"cam_from_world": poses, **fields})
    _check_agreement(node, members, poses, placed_poses)
    copies = len(lenses) - num_declared
    notes = (f"{copies} cameras were copied: COLMAP needs a camera for each sensor of a rig.",)
    return RigFields(
        new_camera,
        np.array(lenses, np.intp),
        {"cam_from_world": placed_poses, **fields},
        notes if copies else (),
    )


def _groups(members: dict[str, list[tuple[int, str]]]) -> dict[str, int]:
    """Return the rig of each rig camera that shares an instance with another."""
    group: dict[str, int] = {}
    for instance in members.values():
        names = [rig for _, rig in instance]
        if len(names) < 2:
            continue
        joined = {group[name] for name in names if name in group}
        number = min(joined, default=len(group))
        for name in [*names, *(name for name, old in group.items() if old in joined)]:
            group[name] = number
    order = {old: new for new, old in enumerate(dict.fromkeys(group.values()))}
    return {name: order[old] for name, old in group.items()}


def _product(a: Array, b: Array) -> Array:
    product: Array = multiply_poses(a[None], b[None])[0]
    return product


def _check_agreement(
    node: Node, members: dict[str, list[tuple[int, str]]], poses: Array, others: Array
) -> None:
    angle, shift, spread = pose_differences(others, poses)
    for name, instance in members.items():
        for image, _ in instance:
            if angle[image] > _TOLERANCE or shift[image] > _TOLERANCE * max(spread, 1e-300):
                raise InputError(
                    f"{node.place}: rig_instances: {name}: expected a pose that agrees with "
                    f"its shots, found a difference of {np.degrees(angle[image]):.3g} degrees and "
                    f"{shift[image]:.3g} units"
                )
