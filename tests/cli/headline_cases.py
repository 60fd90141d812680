"""Refinements whose outcome is easily misread: scenes, flags, and known facts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.cli.test_align import written
from tests.cli.test_gcp import TARGETS
from tests.cli.test_gps import write_geo
from tests.georeference.flights import flight as flown
from tests.georeference.test_prior_alignment import problem_and_goal
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem


@dataclass
class Case:
    """Problem, flags, and facts that are known without any computation.

    Attributes:
        problem: INPUT.
        flags: flags of the command, "{folder}" for the folder of the case.
        code: exit code.
        minimum: True if INPUT is at its minimum, False if not; None: unknown.
        deletes: True if observations are deleted.
        edits: names of the edits in JSON.
        before: commands that make INPUT from the problem, run first.
        again: True to run twice, the second run from the checkpoint of the first.
        interrupt: iteration after which Ctrl-C comes; None: never.
        rounds_before: number of adjustments before the one that is interrupted.
        files: function that writes further files into the folder of the case.
    """

    problem: Any
    flags: str = ""
    code: int = 0
    minimum: bool | None = False
    deletes: bool = False
    edits: tuple[str, ...] = ()
    before: tuple[str, ...] = ()
    again: bool = False
    interrupt: int | None = None
    rounds_before: int = 0
    files: Any = field(default=lambda _folder: None)


def outliers(share=0.05, seed=0, **settings):
    """A scene with gross errors in some observations."""
    problem = make_problem(num_images=6, num_points=60, seed=seed, **settings)
    rng = np.random.default_rng(seed)
    wrong = rng.random(problem.num_observations) < share
    size = np.exp(rng.uniform(np.log(6), np.log(60), len(wrong)))
    xy = problem.observation_xy + (wrong * size)[:, None] * rng.choice([-1, 1], (len(wrong), 2))
    return problem.replace(observation_xy=xy)


def behind(points=(3, 4)):
    """A scene in which some points are behind all cameras."""
    problem = make_problem(num_images=5)
    moved = problem.points.copy()
    moved[list(points)] = [0, 0, -40.0]
    return problem.replace(points=moved)


def one_bad_image():
    """A scene in which all observations of the last image are wrong."""
    problem = make_problem(num_images=6, noise=0.3)
    xy = problem.observation_xy.copy()
    last = problem.observation_image == 5
    xy[last] += 900 * np.random.default_rng(1).standard_normal((last.sum(), 2))
    return problem.replace(observation_xy=xy)


def two_views():
    """A scene of points that two images see."""
    return make_problem(num_images=6, num_points=80, track=2)


def exact():
    """A scene without noise, at the truth."""
    return make_problem(noise=0, perturbation=0)


def placed(noise=0.5):
    return problem_and_goal(noise=noise)[0]


def flight():
    """A flight over control points."""
    return flown(TARGETS, num_images=9, num_points=60, start_noise=0.05)


def geo(offset=0.0):
    """A writer of geo.txt, one of whose positions is off by an offset in metres."""

    def write(folder):
        problem, goal = problem_and_goal()
        enu = goal.projection_centers + 0.05 * np.random.default_rng(2).standard_normal((8, 3))
        enu[3, 0] += offset
        write_geo(folder / "geo.txt", problem.image_names, enu)

    return write


GPS = "--gps {folder}/geo.txt --gps-sigma"
CASES = {
    "plain": Case(make_problem()),
    "ceres": Case(make_problem(seed=1), "--backend ceres"),
    "outliers": Case(outliers()),
    "two views": Case(two_views()),
    "one camera": Case(make_problem(shared=True)),
    "at the minimum": Case(make_problem(), minimum=True, before=("",)),
    "at the minimum with outliers": Case(outliers(), minimum=True, before=("",)),
    "at the minimum of a loss": Case(
        outliers(), "--loss cauchy", minimum=True, before=("--loss cauchy",)
    ),
    "at the minimum of least squares, under a loss": Case(
        outliers(), "--loss cauchy", before=("",)
    ),
    "at the minimum, then shared": Case(
        make_problem(), "--share-cameras all", before=("",), edits=("share_cameras",)
    ),
    "at the minimum, then another lens": Case(
        make_problem(), "--camera-model RADIAL", minimum=None, before=("",), edits=("camera_model",)
    ),
    "at the minimum, then rounds": Case(
        outliers(), "--rounds 2 --max-error 3", before=("",), deletes=True
    ),
    "exact": Case(exact(), minimum=None),
    "exact, from a distance": Case(make_problem(noise=0)),
    "loose tolerance": Case(make_problem(), "--function-tolerance 0.5"),
    "no step": Case(make_problem(), "--max-iterations 0"),
    "one step": Case(make_problem(), "--max-iterations 1"),
    "cauchy": Case(outliers(), "--loss cauchy"),
    "huber": Case(outliers(seed=1), "--loss huber --loss-scale 0.5"),
    "tukey": Case(outliers(share=0.15), "--loss tukey --loss-scale 4"),
    "soft-l1": Case(outliers(share=0.1), "--loss soft-l1"),
    "loss without outliers": Case(make_problem(), "--loss cauchy --loss-scale 3"),
    "rounds": Case(outliers(), "--rounds 3 --max-error 2", deletes=True),
    "rounds under a loss": Case(outliers(), "--rounds 3 --max-error 2 --loss cauchy", deletes=True),
    "rounds delete nothing": Case(make_problem(), "--rounds 3 --max-error 100"),
    "rounds delete points": Case(two_views(), "--rounds 2 --max-error 0.1", deletes=True),
    "rounds delete an image": Case(
        one_bad_image(), "--rounds 2 --max-error 5 --loss cauchy --fix-images 6", deletes=True
    ),
    "a few steps a round": Case(
        outliers(), "--rounds 2 --max-error 3 --max-iterations 1", deletes=True
    ),
    "shared": Case(make_problem(), "--share-cameras all", edits=("share_cameras",)),
    "split": Case(make_problem(shared=True), "--split-cameras", edits=("split_cameras",)),
    "a smaller lens": Case(
        make_problem(model="OPENCV"), "--camera-model SIMPLE_RADIAL", edits=("camera_model",)
    ),
    "three edits and rounds": Case(
        outliers(shared=True),
        "--camera-model RADIAL --split-cameras --rounds 2 --max-error 3",
        edits=("camera_model", "split_cameras"),
        deletes=True,
    ),
    "a rule shares": Case(make_problem(), "--set 'cameras *: share f'", edits=("rules",)),
    "a rule pulls": Case(make_problem(), "--set 'camera 1: f prior 700 sigma 0.1'"),
    "GPS": Case(placed(), f"{GPS} 0.1", minimum=None, edits=("alignment",), files=geo()),
    "GPS pulls": Case(placed(), f"{GPS} 0.001", edits=("alignment",), files=geo(8.0)),
    "GPS and rounds": Case(
        placed(),
        f"{GPS} 0.1 --rounds 2 --max-error 1.2",
        edits=("alignment",),
        deletes=True,
        files=geo(),
    ),
    "one image fixed": Case(make_problem(), "--fix-images 3"),
    "all images fixed": Case(make_problem(), "--fix-images 1-5 --gauge none"),
    "points only": Case(make_problem(), "--refine points"),
    "nothing to refine": Case(make_problem(), "--fix-images 1-5 --refine poses", minimum=None),
    "only some images": Case(make_problem(), "--only-images 2,3"),
    "only some images, in rounds": Case(
        outliers(), "--only-images 2,3 --rounds 2 --max-error 3", deletes=True
    ),
    "only some images, marginal rest": Case(
        make_problem(num_images=8, track=3), "--only-images 2,3 --rest marginal", minimum=None
    ),
    "behind cameras": Case(behind(), "--cheirality zero", minimum=None),
    "behind cameras, algebraic": Case(behind(), "--cheirality algebraic", minimum=None),
    "no usable solution": Case(behind(range(40)), "--cheirality zero", code=1, minimum=None),
    "interrupted": Case(make_problem(), "--function-tolerance 1e-16", code=1, interrupt=1),
    "interrupted in the second round": Case(
        outliers(),
        "--rounds 3 --max-error 3 --loss huber",
        code=1,
        deletes=True,
        interrupt=1,
        rounds_before=1,
    ),
    "control and check points": Case(
        flight().elsewhere(),
        "--gcp {folder}/gcp_list.txt --gcp-sigma 0.03 --check-points t4,t5",
        minimum=None,
        edits=("alignment",),
        files=lambda folder: written(folder / "gcp_list.txt", flight().gcps),
    ),
    "rigs": Case(rig_problem(), "--refine poses,points,sensor-from-rig"),
    "resumed": Case(
        make_problem(), "--resume {folder}/state --function-tolerance 1e-12", again=True
    ),
    "resumed rounds": Case(
        outliers(), "--resume {folder}/state --rounds 2 --max-error 3", again=True, deletes=True
    ),
    "held out": Case(outliers(), "--hold-out 10"),
}
