"""Solves with a gauge against the same solves without one: the final cost is the same.

Random problems hold 0 to 3 points (also on a line or at one place) and 0 to 2 images, by options or
by rules; some have rigs whose sensors are fixed or refined, priors, rules that hold a part of an
image, or a world that is scaled, turned and shifted. Each is solved with gauge "none", with the
default and, where nothing says where the world is, with "two_cameras"; odd seeds by Ceres.

python -m tests.campaigns.gauges COUNT [SEED]
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from tests.rig_scenes import FIVE, STEREO, rig_problem
from tests.scenes import make_problem

TOLERANCE = 1e-9
EXACT = {
    "function_tolerance": 1e-16,
    "gradient_tolerance": 0.0,
    "parameter_tolerance": 1e-14,
    "max_num_iterations": 300,
    "check_solution": False,
}


@dataclass
class Case:
    """A problem, what holds it, and what kinds of things do."""

    problem: bundle.Problem
    settings: dict[str, Any]
    kinds: list[str] = field(default_factory=list)
    locates: bool = False  # something says where images or points are

    def solve(self, gauge: str) -> bundle.Result:
        """Solve it exactly."""
        return bundle.solve(self.problem, gauge=gauge, **EXACT, **self.settings)


class Comparison(NamedTuple):
    """The final cost with a gauge beside that without one."""

    seed: int
    gauge: str
    kinds: tuple[str, ...]
    cost: float
    expected: float
    warnings: tuple[str, ...]

    @property
    def difference(self) -> float:
        """Return the relative difference."""
        return abs(self.cost - self.expected) / max(self.expected, 1e-9)

    @property
    def is_wrong(self) -> bool:
        """Return whether the gauge changes the minimum."""
        return not self.difference <= TOLERANCE


def random_case(seed: int) -> Case:
    """Return a random problem."""
    rng = np.random.default_rng(seed)
    scene: dict[str, Any] = {
        "num_points": int(rng.integers(20, 50)),
        "noise": float(rng.choice([0.3, 1.0])),
        "perturbation": float(rng.choice([1e-3, 5e-3])),
        "model": str(rng.choice(["PINHOLE", "SIMPLE_RADIAL", "OPENCV", "SIMPLE_RADIAL_FISHEYE"])),
        "seed": seed,
    }
    kind = str(rng.choice(["images", "images", "rigs", "rigs"]))
    if kind == "rigs":
        rigs = [(STEREO,), (STEREO, STEREO), (FIVE,)][rng.integers(3)]
        sizes = {"num_frames": int(rng.integers(2, 5)), "num_alone": int(rng.integers(0, 3))}
        problem = rig_problem(rigs=rigs, **sizes, **scene)
    else:
        scene["num_images"] = int(rng.integers(3, 8))
        if rng.random() < 0.4:  # as many points as determine the intrinsics
            scene |= {"track": 3, "num_points": scene["num_points"] + 50}
        problem = make_problem(shared=bool(rng.random() < 0.5), **scene)
    case = Case(problem.replace(format="colmap"), {"num_threads": 1}, [kind])
    if rng.random() < 0.4:
        _move(case, rng)
    if rng.random() < 0.3:
        case.settings |= {"loss": "huber", "loss_scale": 1.0}
        case.kinds.append("loss")
    if seed % 2:
        case.settings["backend"] = "ceres"
        case.kinds.append("ceres")
    if kind == "rigs" and rng.random() < 0.6:
        _free_sensors(case, rng)
    rules: list[str] = []
    _hold_points(case, rng, rules)
    _hold_images(case, rng, rules)
    _know(case, rng, rules)
    if rules:
        case.settings["constraints"] = rules
    return case


def _move(case: Case, rng: np.random.Generator) -> None:
    """Scale, turn and shift the world: the images stay what they are."""
    problem = case.problem
    scale = float(rng.choice([0.01, 1.0, 100.0]))
    shift = scale * float(rng.choice([1, 30])) * rng.standard_normal(3)
    turn = Rotation.from_rotvec(rng.uniform(-2, 2, 3))

    def moved(poses: Any) -> Any:
        rotations = Rotation.from_quat(poses[:, :4].copy()) * turn.inv()
        return np.hstack([rotations.as_quat(), scale * poses[:, 4:] - rotations.apply(shift)])

    changes: dict[str, Any] = {"points": scale * turn.apply(problem.points.copy()) + shift}
    if problem.num_frames:
        sensors = problem.sensor_from_rig.copy()
        sensors[:, 4:] *= scale
        changes |= {"rig_from_world": moved(problem.rig_from_world), "sensor_from_rig": sensors}
        alone = problem.image_frame < 0
        poses = problem.replace(**{k: changes[k] for k in changes if k != "points"}).cam_from_world
        changes["cam_from_world"] = np.where(alone[:, None], moved(problem.cam_from_world), poses)
    else:
        changes["cam_from_world"] = moved(problem.cam_from_world)
    case.problem = problem.replace(**changes)
    case.kinds.append("moved")


def _free_sensors(case: Case, rng: np.random.Generator) -> None:
    problem = case.problem
    case.settings["refine_sensor_from_rig"] = True
    case.kinds.append("sensors")
    if rng.random() < 0.3:
        row = int(rng.integers(problem.num_sensors))
        ids = (int(problem.sensor_rig_ids[row]), int(problem.sensor_camera_ids[row]))
        case.settings["fixed_sensors"] = (ids,)
        case.kinds.append("one sensor held")


def _hold_points(case: Case, rng: np.random.Generator, rules: list[str]) -> None:
    problem = case.problem
    count = int(rng.integers(4))
    rows = rng.choice(problem.num_points, count, replace=False)
    if count > 1 and rng.random() < 0.3:
        points = problem.points.copy()
        if count == 3:  # on a line
            points[rows[2]] = points[rows[0]] + 0.4 * (points[rows[1]] - points[rows[0]])
        else:  # at one place
            points[rows[1]] = points[rows[0]]
        moved = problem.replace(points=points)
        errors = bundle.model.residuals.linearize(moved).residual  # seen where they are now
        seen = np.isin(moved.observation_point, rows)
        xy = moved.observation_xy + np.where(seen[:, None], errors, 0.0)
        noise = 0.3 * rng.standard_normal(xy.shape)
        case.problem = moved.replace(observation_xy=xy + np.where(seen[:, None], noise, 0.0))
        case.kinds.append("degenerate points")
    ids = problem.point_ids[rows].tolist()
    if count and rng.random() < 0.5:
        rules += [f"point {key}: position fixed" for key in ids]
    elif count:
        case.settings["fixed_point_ids"] = tuple(ids)
    case.kinds.append(f"{count} points")


def _hold_images(case: Case, rng: np.random.Generator, rules: list[str]) -> None:
    problem = case.problem
    can = np.ones(problem.num_images, bool)
    if "sensors" in case.kinds:  # what a refined sensor moves cannot be held
        can = problem.image_sensor < 0
    rows = rng.permutation(np.flatnonzero(can))[: int(rng.integers(3))]
    alone = np.ones(problem.num_images, bool)
    if problem.num_frames:
        alone = problem.image_frame < 0
    fixed = []
    for row in rows.tolist():
        key = int(problem.image_ids[row])
        how = float(rng.random())
        if how < 0.5 or not alone[row]:
            fixed.append(key)
            continue
        parts = ["position,rotation", "position", "rotation"][int(rng.integers(3))]
        rules.append(f"image {key}: {parts} fixed")
        case.kinds.append(f"{parts} held")
    if fixed:
        case.settings["fixed_image_ids"] = tuple(fixed)
    case.kinds.append(f"{len(rows)} images")


def _know(case: Case, rng: np.random.Generator, rules: list[str]) -> None:
    problem = case.problem
    if rng.random() < 0.3:
        rules.append("cameras *: f prior 2 %")
        case.kinds.append("focal prior")
    if rng.random() < 0.2:
        held = {*case.settings.get("fixed_point_ids", ())}
        free = [key for key in problem.point_ids.tolist()[:8] if key not in held]
        free = [key for key in free if f"point {key}: position fixed" not in rules]
        spread = 0.01 * float(np.ptp(problem.points))
        rules += [f"point {key}: position prior sigma {spread}" for key in free[:2]]
        case.kinds.append("point priors")
        case.locates = True


def compare_seed(seed: int) -> list[Comparison]:
    """Solve one problem with each gauge that leaves its minimum."""
    case = random_case(seed)
    expected = case.solve("none").summary
    found = []
    for gauge in ("auto",) if case.locates else ("auto", "two_cameras"):
        summary = case.solve(gauge).summary
        costs = (float(summary.final_cost), float(expected.final_cost))
        found.append(Comparison(seed, gauge, tuple(case.kinds), *costs, summary.warning_kinds))
    return found


def campaign(count: int, seed: int = 0) -> list[Comparison]:
    """Compare so many problems."""
    return [entry for n in range(seed, seed + count) for entry in compare_seed(n)]


def main() -> int:
    """Print the largest differences: 0 if there is none beyond the tolerance."""
    count = int(sys.argv[1])
    found = campaign(count, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    found.sort(key=lambda entry: -entry.difference)
    wrong = [entry for entry in found if entry.is_wrong]
    for entry in (*wrong, *found[len(wrong) : len(wrong) + 5]):
        print(
            f"seed {entry.seed}, {entry.gauge}: {entry.cost:.12g} for {entry.expected:.12g}, "
            f"{entry.difference:.2g} ({', '.join(entry.kinds)}) {' '.join(entry.warnings)}"
        )
    kinds = Counter(kind for entry in found for kind in entry.kinds)
    print(", ".join(f"{kind}: {number}" for kind, number in sorted(kinds.items())))
    print(f"{count} problems, {len(found)} solves with a gauge, {len(wrong)} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
