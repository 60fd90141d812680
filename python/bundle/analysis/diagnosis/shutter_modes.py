r"""Images whose rolling-shutter motion the observations do not determine.

With free twists, a flat scene has one nearly free direction per image: a twist that bends the image
is compensated by pose and points (Albl, Sugimoto and Pajdla, ECCV 2016, "Degeneracies in rolling
shutter SfM"). Minimising the residuals then ends in wrong poses while the RMSE looks better. If the
camera only translates, the direction is free exactly for a lens without distortion.

Spectrum at the fixed point (shutter_spectrum.py). Eigenvalues of the scaled system below 1e-5 count
as weak: seeded flights over flat ground have one to two of them per image; over a relief of 5 % of
the height at most 0.4, walks and drives none. An image is named if the weak directions contain 0.7
of a direction of its unknowns, and its points are flat: their relief about a plane is below 2 % of
their distance. Where all images are flat, the weak directions of a long road reach 3e-5, and those
below 5e-5 count; the next are above 2e-4. Eigenvalues below 1e-11 are zero; if they contain 0.7 of
a direction of an image, it is named for any scene.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import WeakMode
from bundle.analysis.diagnosis.shutter_spectrum import ShutterSpectrum, shutter_spectrum
from bundle.analysis.diagnosis.viewing import plane
from bundle.base.words import named, plural, sorted_ids
from bundle.model.problem import Problem
from bundle.model.rotations import quaternion_inverse, quaternion_rotate

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
            camera_ids=(),
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
            f"the observations leave a direction of each of {count} free.",
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
    """Return how much of a direction of each image's unknowns eigenvalues below a limit contain."""
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
