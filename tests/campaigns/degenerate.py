"""Legal problems without a good answer, at random, under random options and both backends.

python -m tests.campaigns.degenerate COUNT [SEED]
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

import bundle
from bundle.analysis.statistics.description import describe
from bundle.interface.option_fields import REFINABLE
from bundle.interface.options import GAUGES, LOSSES, ORDERINGS, TRUST_REGION_STRATEGIES
from tests import scenes
from tests.campaigns import jobs
from tests.campaigns.mutants import assert_honest

SOLVERS = ("auto", "dense_schur", "sparse_schur", "iterative_schur")
CERES_SOLVERS = (*SOLVERS, "sparse_normal_cholesky", "dense_normal_cholesky", "dense_qr", "cgnr")
MODELS = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")
Edit = Callable[[bundle.Problem, np.random.Generator], bundle.Problem]


def keep(problem: bundle.Problem, index: np.ndarray) -> bundle.Problem:
    """Return the problem with these observations, in this order."""
    return problem.replace(
        observation_image=problem.observation_image[index],
        observation_point=problem.observation_point[index],
        observation_xy=problem.observation_xy[index],
        observation_keypoint=problem.observation_keypoint[index],
    )


def drop(problem, rng):
    """Leave few observations, down to none."""
    share = rng.choice([0.0, 0.02, 0.1, 0.3, 0.6])
    return keep(problem, np.flatnonzero(rng.random(problem.num_observations) < share))


def repeat(problem, rng):
    """Let tracks visit an image several times."""
    n = problem.num_observations
    return keep(problem, rng.integers(0, n, size=rng.integers(n, 3 * n + 1)))


def split(problem, rng):
    """Make two components that share no point."""
    cut_images = rng.integers(0, problem.num_images + 1)
    cut_points = rng.integers(0, problem.num_points + 1)
    side = (problem.observation_image < cut_images) == (problem.observation_point < cut_points)
    return keep(problem, np.flatnonzero(side))


def scale(problem, rng):
    """Scale the world by up to 1e±150."""
    factor = 10.0 ** rng.uniform(-150, 150) if rng.random() < 0.3 else 10.0 ** rng.uniform(-9, 9)
    poses = problem.cam_from_world.copy()
    poses[:, 4:] *= factor
    return problem.replace(cam_from_world=poses, points=problem.points * factor)


def shift(problem, rng):
    """Move the world far from its origin."""
    offset = rng.normal(size=3) * 10.0 ** rng.uniform(2, 12)
    x, y, z, w = problem.cam_from_world[:, :4].T
    poses = problem.cam_from_world.copy()
    u = np.stack([x, y, z], axis=1)
    turned = offset + 2 * (
        w[:, None] * np.cross(u, offset) + np.cross(u, np.cross(u, offset[None]))
    )
    poses[:, 4:] -= turned
    return problem.replace(cam_from_world=poses, points=problem.points + offset)


def collapse(problem, rng):
    """Put points onto each other, a camera centre, a line, or far away."""
    points = problem.points.copy()
    if not len(points):
        return problem
    some = rng.random(len(points)) < rng.choice([0.05, 0.5, 1.0])
    kind = rng.integers(5)
    if kind == 0:
        points[some] = points[0]
    elif kind == 1:
        points[some] = bundle_centers(problem)[rng.integers(problem.num_images)]
    elif kind == 2:
        points[some] *= [1.0, 0.0, 0.0]
    elif kind == 3:
        points[some] *= 10.0 ** rng.uniform(3, 15)
    else:
        points[some] = rng.normal(size=(some.sum(), 3)) * 1e-9
    return problem.replace(points=points)


def bundle_centers(problem):
    """Return the camera centres, (num_images, 3)."""
    x, y, z, w = problem.cam_from_world[:, :4].T
    t = -problem.cam_from_world[:, 4:]
    u = np.stack([-x, -y, -z], axis=1)
    return t + 2 * (w[:, None] * np.cross(u, t) + np.cross(u, np.cross(u, t)))


def cluster_images(problem, rng):
    """Give several images one pose: no baseline."""
    poses = problem.cam_from_world.copy()
    some = rng.random(len(poses)) < rng.choice([0.3, 1.0])
    poses[some] = poses[0]
    return problem.replace(cam_from_world=poses)


def turn_away(problem, rng):
    """Put some or all points behind some images."""
    poses = problem.cam_from_world.copy()
    some = rng.random(len(poses)) < rng.choice([0.2, 1.0])
    poses[some, 6] -= rng.choice([1.0, 10.0, 1000.0])
    return problem.replace(cam_from_world=poses)


def nonsense(problem, rng):
    """Measure anything."""
    size = 10.0 ** rng.uniform(0, rng.choice([4, 150]))
    xy = problem.observation_xy + rng.normal(size=problem.observation_xy.shape) * size
    return problem.replace(observation_xy=xy)


def wild_camera(problem, rng):
    """Give the cameras parameters far from any lens."""
    params = problem.camera_params.copy()
    used = params != 0
    factor = 10.0 ** rng.uniform(-3, rng.choice([3, 100]), size=params.shape)
    return problem.replace(camera_params=np.where(used, params * factor, params))


EDITS: tuple[Edit, ...] = (
    drop,
    repeat,
    split,
    scale,
    shift,
    collapse,
    cluster_images,
    turn_away,
    nonsense,
    wild_camera,
)


def draw_problem(rng: np.random.Generator) -> bundle.Problem:
    """Return a small scene with one to three edits."""
    num_images = int(rng.integers(1, 8))
    problem = scenes.make_problem(
        num_images=num_images,
        num_points=int(rng.integers(1, 50)),
        model=str(rng.choice(MODELS)),
        shared=bool(rng.random() < 0.5),
        track=int(rng.integers(1, num_images + 1)),
        perturbation=float(rng.choice([0.0, 1e-2, 0.3])),
        seed=int(rng.integers(1 << 30)),
    )
    for edit in rng.choice(np.array(EDITS, dtype=object), size=rng.integers(1, 4), replace=False):
        problem = edit(problem, rng)
    return problem


def draw_options(rng: np.random.Generator) -> dict[str, object]:
    """Return options that both backends may be asked for."""
    backend = str(rng.choice(["auto", "ceres"]))
    refined = [name for name in REFINABLE if rng.random() < 0.7] or ["points"]
    return {
        "backend": backend,
        "linear_solver_type": str(rng.choice(CERES_SOLVERS if backend == "ceres" else SOLVERS)),
        "linear_solver_ordering": str(rng.choice(ORDERINGS))
        if rng.random() < 0.2
        else ORDERINGS[0],
        "trust_region_strategy_type": str(rng.choice(TRUST_REGION_STRATEGIES)),
        "loss": (loss := str(rng.choice(LOSSES))),
        **({} if loss == "trivial" else {"loss_scale": float(10.0 ** rng.uniform(-3, 3))}),
        "gauge": str(rng.choice(GAUGES)),
        "cheirality": str(rng.choice(["auto", "algebraic", "zero"])),
        "refine": refined,
        "max_num_iterations": int(rng.choice([0, 1, 10, 40])),
        "num_threads": int(rng.choice([1, 2])),
    }


def exercise(job: str) -> str:
    """Solve the problem of one seed; return how it ended."""
    rng = np.random.default_rng([int(part) for part in job.split("-")])
    problem, options = draw_problem(rng), draw_options(rng)
    result = bundle.solve(problem, **options)
    assert_honest(result)
    describe(result.problem)
    assert str(result)
    assert result.summary.full_report()
    return f"{result.summary.termination_type} usable={result.summary.is_solution_usable}"


def campaign(count: int, seed: int = 0) -> list[jobs.Outcome]:
    """Solve `count` problems."""
    name = __spec__.name if __spec__ else __name__
    return jobs.run(f"{name}:exercise", [f"{seed}-{index}" for index in range(count)])


if __name__ == "__main__":
    print(jobs.summarise(campaign(int(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else 0)))
