"""Seeded and real problems for the study of steps: each a name, a problem and its options."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from bundle import Problem
from tests.rig_scenes import FIVE, STEREO, rig_problem
from tests.scenes import make_problem

KINDS = ("orbit", "street", "photo_collection", "few", "rigs", "shared", "outliers", "long")
SCENES = KINDS[:3]
SIZES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Perturbations of the start; 1 is the default of ``bundle synth``."""
MOVED = (0.1, 1.0)
MOST_MOVED = 60_000
"""Observations of the largest real set that is also solved from a perturbed start."""


class Case(NamedTuple):
    """A problem to solve."""

    name: str
    problem: Problem
    options: dict[str, Any]


def draw(seed: int) -> Case:
    """Return the problem of a seed; kinds take turns.

    Raises:
        InputError: there is no such scene.
    """
    rng = np.random.default_rng([36, seed])
    kind, size = KINDS[seed % len(KINDS)], float(rng.choice(SIZES))
    noise = float(rng.choice([0.1, 0.5, 1.0]))
    name = f"{seed} {kind} {size:g}"
    small = {"noise": noise, "perturbation": 0.02 * size, "seed": int(rng.integers(2**31))}
    if kind == "rigs":
        problem = rig_problem(
            num_frames=int(rng.choice([4, 8, 15])),
            rigs=(STEREO,) if rng.random() < 0.5 else (FIVE,),
            num_points=int(rng.choice([40, 100, 200])),
            **small,
        )
        return Case(name, problem, {"refine_sensor_from_rig": bool(rng.random() < 0.5)})
    if kind == "shared":
        problem = make_problem(
            num_images=int(rng.choice([4, 8, 16])),
            num_points=int(rng.choice([100, 300])),
            model=str(rng.choice(["OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "PINHOLE"])),
            shared=bool(rng.random() < 0.7),
            **small,
        )
        return Case(name, problem, {})
    num_images = int(rng.choice([2, 3, 4, 5] if kind == "few" else [8, 15, 30, 50]))
    scene: dict[str, Any] = {
        "scene": kind if kind in SCENES else str(rng.choice(SCENES)),
        "num_images": num_images,
        "num_points": num_images * int(rng.choice([40, 80])),
        "camera_model": str(rng.choice(["SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"])),
        "cameras": str(rng.choice(["shared", "individual"])),
        "pixel_noise": noise,
        "rotation_noise": 0.5 * size,
        "translation_noise": 0.005 * size,
        "point_noise": 0.005 * size,
        "focal_noise": min(0.01 * size, 0.2),
        "seed": int(rng.integers(2**31)),
    }
    if not scene["camera_model"].endswith("PINHOLE"):
        scene["distortion_noise"] = 0.005 * min(size, 3.0)
    if kind == "long":
        scene["mean_track_length"] = float(num_images // 3 + 2)
    options: dict[str, Any] = {}
    if kind == "outliers":
        scene["outlier_share"] = float(rng.choice([0.01, 0.05]))
        options["loss"] = str(rng.choice(["huber", "cauchy", "soft_l1", "tukey"]))
        options["loss_scale"] = float(rng.choice([1.0, 3.0]))
    return Case(name, bundle.synthesize(**scene).problem, options)


def seeded(count: int, first: int = 0) -> Iterator[Case]:
    """Draw so many problems, beginning with a seed; seeds without a scene are left out."""
    while count > 0:
        try:
            yield draw(first)
            count -= 1
        except bundle.InputError:  # too few images see a point
            pass
        first += 1


def moved(problem: Problem, size: float) -> Problem:
    """Return a problem with perturbed rotations, positions and points."""
    rng = np.random.default_rng(7)
    spread = np.median(np.linalg.norm(problem.points - np.median(problem.points, axis=0), axis=1))
    poses = problem.cam_from_world.copy()
    turn = Rotation.from_rotvec(np.radians(0.5 * size) * rng.standard_normal((len(poses), 3)))
    poses[:, :4] = (turn * Rotation.from_quat(poses[:, :4])).as_quat()
    shift = 0.005 * size * spread
    poses[:, 4:] = turn.apply(poses[:, 4:]) + shift * rng.standard_normal((len(poses), 3))
    points = problem.points + shift * rng.standard_normal(problem.points.shape)
    return problem.replace(cam_from_world=poses, points=points)


def real(data: Path) -> Iterator[Case]:
    """Yield every reconstruction in a folder, also with a robust loss and from perturbed starts."""
    paths = sorted(data.glob("bal/*.txt.bz2"))
    paths += sorted({path.parent for path in data.rglob("cameras.*")})
    for path in paths:
        problem = bundle.load(path)
        name = str(path.relative_to(data))
        yield Case(name, problem, {})
        yield Case(f"{name}, cauchy", problem, {"loss": "cauchy", "loss_scale": 1.0})
        if problem.num_observations <= MOST_MOVED and not len(problem.frame_ids):
            for size in MOVED:
                yield Case(f"{name}, moved {size:g}", moved(problem, size), {})
