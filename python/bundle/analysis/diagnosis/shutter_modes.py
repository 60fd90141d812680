"""Images whose rolling-shutter motion the observations do not determine.

With free twists, a flat scene has one nearly free direction per image: a twist that bends the image
is compensated by pose and points (Albl, Sugimoto and Pajdla, ECCV 2016, "Degeneracies in rolling
shutter SfM"). Minimising the residuals then ends in wrong poses while the RMSE looks better. If the
camera only translates, the direction is free exactly for a lens without distortion.

Eigenvalues of the scaled system below 1e-5 count
as weak: seeded flights over flat ground have one to two of them per image; over a relief of 5 % of
the height at most 0.4, walks and drives none. An image is named if the weak directions contain 0.7
of a direction of its unknowns, and its points are flat: their relief about a plane is below 2 % of
their distance. If the points of all images are flat, eigenvalues below 5e-5 count: those of a long
road reach 3e-5, and the next are above 2e-4. Eigenvalues below 1e-11 are zero; if they contain 0.7
of a direction of an image, it is named for any scene.

The eigenvalues are computed with the row time s as a function of the parameters (the solution of
s = pi_y(x) / height - 1/2), not with s fixed at the observed row. The residual of an observation is
pi(x) - z with x = Exp(s m) T X. For changes (w, u) of the pose in the frame of the camera,
Exp(w, u) T, d of the twist, and p of the point,

    dx = R_s (w x x_0 + u) + (omega x x + v) + R_s R p,    (omega, v) = s J(s m) d,    x_0 = T X,

where R_s is the rotation of Exp(s m) and J the left Jacobian of SE(3), J = sum ad^k / (k + 1)! with
ad = [[W, 0], [V, W]], W = s [w]x, V = s [v]x of the twist m. With s the row itself, all derivatives
D of pi(x) become

    D + a D_y / (1 - a_y),    a = d pi / dx (w x x + v) / height.

The derivatives at the observed row lack the second term, and hide the null directions: at the
truth, points on a plane that are read parallel to the flight give almost no information along them.

The points are eliminated. Seven directions of poses and twists belong to the gauge (translations t,
rotations e, and the scale of the world):

    t: u = -R t,    e: w = -R e, u = (R e) x T_t,    scale: u = T_t, d = (0, v).

The eigenvalues are those of the reduced system without these, scaled to a unit diagonal. Intrinsics
are constant and twists free: with more free parameters, eigenvalues are smaller or equal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import WeakMode
from bundle.analysis.diagnosis.track_table import plane
from bundle.base.records import dataclass
from bundle.base.words import named, plural, sorted_ids
from bundle.model.cameras import camera_models, project
from bundle.model.point_elimination import eliminate_points, part_of_observations
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    cross_matrices,
    quaternion_inverse,
    quaternion_rotate,
    rotation_matrices,
)
from bundle.model.shutter_motion import moved, read_positions

Floats = NDArray[np.float64]

WEAK = 1e-5
WEAK_IF_ALL_FLAT = 5e-5
ZERO = 1e-11
ENERGY = 0.7
FLAT = 0.02
FEWEST = 2
PURE = 0.02
"""Rotation per translation, both as motions on the image, below which a camera only translates."""
PARALLEL_DEGREES = 15.0

_REMEDY = (
    "Tie them to the poses of their neighbours (--twists tied, with the times of the images), or "
    "add images that see relief. Do not trust a smaller RMSE."
)


def shutter_modes(problem: Problem) -> list[WeakMode]:
    """Return the images whose free twists are not determined; empty without a rolling shutter."""
    shutter = problem.rolling_shutter
    if shutter is None:
        return []
    rolls = shutter.is_rolling[problem.image_camera]
    found = shutter_spectrum(problem)
    if found is None:
        return []
    is_flat = _flat_images(problem, found)
    limit = WEAK_IF_ALL_FLAT if is_flat.all() else WEAK
    weak = (_energy(found, limit) > ENERGY) & is_flat
    null = _energy(found, ZERO) > ENERGY
    chosen = weak | null
    if chosen.sum() < FEWEST:
        return []
    images = found.images[chosen]
    kind, words = _cause(problem, images, is_flat=bool(weak[chosen].any()), null=null[chosen])
    tested = ""
    if len(found.images) < rolls.sum():
        tested = f" {len(found.images)} of {int(rolls.sum())} images were tested."
    dimension = int((found.eigenvalues < (ZERO if null[chosen].all() else limit)).sum())
    return [
        WeakMode(
            kind=kind,
            sentence=f"Twists of {named('image', sorted_ids(problem.image_ids, images))}: {words} "
            f"{_REMEDY}{tested}",
            image_ids=sorted_ids(problem.image_ids, images),
            eigenvalue=max(float(found.eigenvalues[0]), 0.0),
            dimension=dimension,
        )
    ]


def _cause(
    problem: Problem, images: NDArray[np.int64], *, is_flat: bool, null: NDArray[np.bool_]
) -> tuple[str, str]:
    count = plural(len(images), "image")
    if not is_flat:
        return (
            "undetermined_twists",
            f"the observations do not determine one direction in each of {count}.",
        )
    if null.all() or _only_translates(problem, images):
        return (
            "flat_scene_pure_translation",
            "pure translation over a flat scene leaves one direction of pose and twist free for "
            "each image.",
        )
    if _is_parallel(problem, images):
        return (
            "flat_scene_parallel_readout",
            "a flat scene with parallel readout: a bent scene under other twists gives nearly the "
            "same images.",
        )
    return (
        "flat_scene_free_twists",
        "a flat scene: other poses and points under other twists give nearly the same images.",
    )


def _energy(found: ShutterSpectrum, limit: float) -> Floats:
    """Return the share of a direction of each image's unknowns in eigenvalues below a limit."""
    below = found.directions[:, found.eigenvalues < limit]
    energy: Floats = (below**2).reshape(len(found.images), -1).sum(axis=1)
    return energy


def _flat_images(problem: Problem, found: ShutterSpectrum) -> NDArray[np.bool_]:
    """Return (k,) True for images whose points are flat compared with their distance."""
    rows = found.observations
    rows = rows[np.argsort(problem.observation_image[rows], kind="stable")]
    starts = np.searchsorted(problem.observation_image[rows], found.images)
    ends = np.searchsorted(problem.observation_image[rows], found.images, side="right")
    centers = problem.projection_centers
    flat = np.zeros(len(found.images), bool)
    for k, (image, start, end) in enumerate(zip(found.images, starts, ends, strict=True)):
        points = problem.points[problem.observation_point[rows[start:end]]]
        distance = float(np.median(np.linalg.norm(points - centers[image], axis=1)))
        flat[k] = plane(points)[0] < FLAT * distance
    return flat


def _only_translates(problem: Problem, images: NDArray[np.int64]) -> bool:
    shutter = problem.rolling_shutter
    assert shutter is not None
    twist = shutter.twist[images]
    chosen = np.isin(problem.observation_image, images)
    away = (
        problem.points[problem.observation_point[chosen]]
        - problem.projection_centers[problem.observation_image[chosen]]
    )
    distance = float(np.median(np.linalg.norm(away, axis=1)))
    turn = float(np.sqrt((twist[:, :3] ** 2).sum(axis=1).mean()))
    shift = float(np.sqrt((twist[:, 3:] ** 2).sum(axis=1).mean())) / distance
    return shift > 0 and turn < PURE * shift


def _is_parallel(problem: Problem, images: NDArray[np.int64]) -> bool:
    """Return True if the sensors are read along one line of the world, in either sense."""
    shutter = problem.rolling_shutter
    assert shutter is not None
    axis = shutter.axis[problem.image_camera[images]]
    along = np.where((axis == 2)[:, None], [1.0, 0, 0], [0.0, 1, 0])
    world = quaternion_rotate(quaternion_inverse(problem.cam_from_world[images, :4]), along)
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    line = np.linalg.svd(world, full_matrices=False)[2][0]
    off = np.degrees(np.arccos(np.clip(np.abs(world @ line), 0, 1)))
    return float(np.sqrt((off**2).mean())) < PARALLEL_DEGREES


Rows = NDArray[np.int64]

MOST_IMAGES = 40
"""Images that take part: those that share most points with the image of most observations."""
MOST_POINTS = 1500
WIDTH = 12  # unknowns of an image: pose, twist
_GAUGE = 7
_TERMS = 10


@dataclass(frozen=True, eq=False)
class ShutterSpectrum:
    """Eigenvalues and directions of poses and twists without the gauge."""

    images: Rows  # (k,) index of the images that take part; all have a rolling shutter
    observations: Rows  # (n,) index of the observations that take part
    eigenvalues: Floats  # eigenvalues of the scaled reduced system, ascending
    directions: Floats  # (12 k, number) orthonormal directions in scaled unknowns, one per column
    # (12 k,) unscaled per scaled unknowns. One pixel of noise leaves scale * direction /
    # sqrt(eigenvalue) undetermined
    scale: Floats


def shutter_spectrum(problem: Problem) -> ShutterSpectrum | None:
    """Return the spectrum of the images with a rolling shutter; None for fewer than two."""
    shutter = problem.rolling_shutter
    assert shutter is not None
    rolls = shutter.is_rolling[problem.image_camera]
    rows = np.flatnonzero(rolls[problem.observation_image])
    rows = rows[part_of_observations(problem, rows, MOST_IMAGES, MOST_POINTS)]
    if not len(rows):
        return None
    jacobian, d_point, known = shutter_jacobians(problem, rows)
    rows, jacobian, d_point = rows[known], jacobian[known], d_point[known]
    seen = problem.observation_image[rows].astype(np.int64)
    images, image = np.unique(seen, return_inverse=True)
    if len(images) < 2:
        return None
    order = np.argsort(problem.observation_point[rows], kind="stable")
    point = np.unique(problem.observation_point[rows[order]], return_inverse=True)[1]
    size = WIDTH * len(images)
    places = WIDTH * image[order, None] + np.arange(WIDTH)
    nothing = np.zeros((len(rows), 2))
    normal = eliminate_points(jacobian[order], places, d_point[order], nothing, point, size)[0]
    system = normal[:, :-1]
    diagonal = np.sqrt(np.maximum(np.diag(system), 0.0))
    scale = np.where(diagonal > 0, 1 / np.where(diagonal > 0, diagonal, 1.0), 0.0)
    gauge = _gauge(problem, images) * diagonal[:, None]
    basis = np.linalg.qr(gauge, mode="complete")[0][:, _GAUGE:]
    values, vectors = np.linalg.eigh(basis.T @ (system * scale[:, None] * scale) @ basis)
    return ShutterSpectrum(images, rows, values, basis @ vectors, scale)


def shutter_jacobians(problem: Problem, rows: Rows) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return derivatives at the fixed point of observations of rolling shutters.

    Returns:
        (n, 2, 12) by (w, u) and the twist, (n, 2, 3) by the point, and (n,) True for observations
        with a projection.
    """
    shutter = problem.rolling_shutter
    assert shutter is not None
    image = problem.observation_image[rows]
    camera = problem.image_camera[image]
    axis = 2 - shutter.axis[camera].astype(np.int64)
    twist = shutter.twist[image]
    pose = problem.cam_from_world[image]
    rotation = rotation_matrices(pose[:, :4])
    points = problem.points[problem.observation_point[rows]]
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1, keepdims=True)
    start = quaternion_rotate(unit, points) + pose[:, 4:]
    times = read_positions(problem, image, start, twist, axis)[1]
    x = moved(twist, times, start)
    turned = np.stack(
        [
            moved(twist, times, np.broadcast_to(one, x.shape)) - moved(twist, times, 0 * x)
            for one in np.eye(3)
        ],
        axis=2,
    )
    d_x = np.full((len(rows), 2, 3), np.nan)
    for index in np.unique(camera).tolist():
        own = np.flatnonzero(camera == index)
        model = problem.camera_models[index]
        params = problem.camera_params[index, : len(camera_models()[model])]
        d_x[own] = project(model, params, x[own], jacobians=True).d_point
    step = times[:, None, None] * _left_jacobians(times[:, None] * twist)
    by_pose = turned @ np.concatenate(
        [-cross_matrices(start), np.broadcast_to(np.eye(3), (len(rows), 3, 3))], axis=2
    )
    by_twist = -cross_matrices(x) @ step[:, :3] + step[:, 3:]
    jacobian = d_x @ np.concatenate([by_pose, by_twist, turned @ rotation], axis=2)
    size = problem.camera_sizes[camera, axis].astype(float)
    a = (d_x @ (np.cross(twist[:, :3], x) + twist[:, 3:])[:, :, None])[:, :, 0] / size[:, None]
    index = np.arange(len(rows))
    along = jacobian[index, axis] / (1 - a[index, axis])[:, None]
    jacobian = jacobian + a[:, :, None] * along[:, None, :]
    known = np.isfinite(jacobian).all(axis=(1, 2))
    return jacobian[:, :, :WIDTH], jacobian[:, :, WIDTH:], known


def _left_jacobians(twists: Floats) -> Floats:
    """Return J (n, 6, 6) of twists (n, 6), rotation first: the sum converges for angles below 1."""
    turn, shift = cross_matrices(twists[:, :3]), cross_matrices(twists[:, 3:])
    ad = np.concatenate(
        [
            np.concatenate([turn, np.zeros_like(turn)], axis=2),
            np.concatenate([shift, turn], axis=2),
        ],
        axis=1,
    )
    found = np.broadcast_to(np.eye(6), ad.shape)
    for k in reversed(range(2, _TERMS + 2)):
        found = np.eye(6) + ad @ found / k
    return found


def _gauge(problem: Problem, images: Rows) -> Floats:
    """Return the seven directions of the gauge (12 k, 7) of some images."""
    shutter = problem.rolling_shutter
    assert shutter is not None
    rotation = rotation_matrices(problem.cam_from_world[images, :4])
    t = problem.cam_from_world[images, 4:]
    found = np.zeros((len(images), WIDTH, _GAUGE))
    found[:, 3:6, :3] = -rotation
    found[:, :3, 3:6] = -rotation
    found[:, 3:6, 3:6] = np.cross(np.swapaxes(rotation, 1, 2), t[:, None, :]).swapaxes(1, 2)
    found[:, 3:6, 6] = t
    found[:, 9:, 6] = shutter.twist[images, 3:]
    # Rotations about the middle of the cameras: far origins would make these parallel to shifts.
    center = problem.projection_centers[images].mean(axis=0)
    found[:, :, 3:6] += found[:, :, :3] @ cross_matrices(center[None])[0].T
    found[:, :, 6] += found[:, :, :3] @ center
    return found.reshape(-1, _GAUGE)
