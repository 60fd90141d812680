"""Covariances of random small problems with everything in them, against dense linear algebra.

Rigs, priors, ties, fixed parts, bounds, every loss, both meanings of it, all gauges.

python -m tests.campaigns.covariance COUNT [SEED]
"""

from __future__ import annotations

import dataclasses
import sys
from typing import NamedTuple

import numpy as np

import bundle
from tests.uncertainty.random_problems import Case, random_case
from tests.uncertainty.test_covariance import blocks

GAUGES = ("inner", "inner", "two_cameras", "three_points", "none")
LIMIT = 1e-8


class Verdict(NamedTuple):
    """What became of one problem."""

    seed: int
    settings: dict
    error: float
    """The largest difference of a block beside its largest entry; under the sandwich beside the
    largest of its kind: two products with the inverse leave small blocks fewer digits."""
    of: str
    """The kind of that block; of a covariance that failed, what it said."""


def draw(seed: int) -> Case:
    """Return a random case with a gauge, a meaning of the loss and bounds beside the rest."""
    case = random_case(seed)
    rng = np.random.default_rng([seed, 1])
    settings = dict(case.settings)
    settings["gauge"] = str(rng.choice(GAUGES))
    basis = case.basis
    if rng.random() < 0.4 and "constraints" not in settings:
        basis = _bound_focal(case, settings, rng)
    is_convex = case.dense.along is not None and (case.dense.along >= 0).all()
    if rng.random() < 0.5 and is_convex:
        settings["robust"] = "sandwich"
    return dataclasses.replace(case, settings=settings, basis=basis)


def _bound_focal(case: Case, settings: dict, rng: np.random.Generator) -> np.ndarray:
    """Put a focal length on a bound: it is held if the cost falls beyond."""
    problem = case.problem
    camera = int(rng.integers(problem.num_cameras))
    column = case.dense.column["camera", camera, 0]
    gradient = case.dense.jacobian[:, column] @ case.dense.residual
    width = len(bundle.camera_models()[problem.camera_models[camera]])
    low, high = np.full(width, -np.inf), np.full(width, np.inf)
    is_upper = rng.random() < 0.5
    (high if is_upper else low)[0] = problem.camera_params[camera, 0]
    settings["bounds"] = {("camera", int(problem.camera_ids[camera])): (low, high)}
    is_held = gradient < 0 if is_upper else gradient > 0
    return case.basis[:, case.basis[column] == 0] if is_held else case.basis


def held_by_gauge(case: Case, cov: bundle.Covariance) -> np.ndarray:
    """Return, of each column of the dense form, whether a gauge gave it no covariance."""
    held = np.zeros(len(case.dense.names), bool)
    column = case.dense.column
    free = case.basis.any(axis=1)
    for kind, values in (
        ("image", cov.pose_covariance),
        ("frame", cov.frame_covariance),
        ("sensor", cov.sensor_covariance),
        ("point", cov.point_covariance),
    ):
        for i, block in enumerate(values):
            if (kind, i, 0) in column:
                first = column[kind, i, 0]
                held[first : first + len(block)] = np.diag(block) == 0
    return held & free


def compare(seed: int) -> Verdict | None:
    """Compare one problem; None if it has no covariance by the dense form either."""
    case = draw(seed)
    settings = dict(case.settings)
    sandwich = settings.get("robust") == "sandwich"
    basis = case.basis
    try:
        dense = case.dense.covariance(basis, sandwich=sandwich, num_priors=case.num_prior_rows)
    except AssertionError:  # a mode too weak for either
        return None
    if settings["gauge"] == "none" and case.dense.degrees > 0:
        settings["gauge"] = "inner"
    try:
        cov = bundle.covariance(case.problem, factors=case.factors, num_threads=1, **settings)
    except bundle.InputError as error:
        return Verdict(seed, settings, np.inf, str(error))
    if settings["gauge"] in ("two_cameras", "three_points"):
        held = held_by_gauge(case, cov)
        # Three points take nine, two cameras what is left, at most seven.
        if held.sum() < case.dense.degrees:
            return Verdict(seed, settings, np.inf, f"{held.sum()} held")
        basis = basis[:, ~basis[held].any(axis=0)] if held.any() else basis
        dense = case.dense.covariance(basis, sandwich=sandwich, num_priors=case.num_prior_rows)
    case = dataclasses.replace(case, basis=basis)
    worst, of = 0.0, ""
    pairs = list(blocks(case, dense, cov))
    largest = {k: max(np.abs(b).max() for kind, _, b in pairs if kind == k) for k, _, _ in pairs}
    for kind, ours, theirs in pairs:
        scale = largest[kind] if sandwich else np.abs(theirs).max()
        error = np.abs(ours - theirs).max() / (scale if scale > 0 else 1)
        if not error <= worst:
            worst, of = float(error), kind
    return Verdict(seed, settings, worst, of)


def campaign(count: int, seed: int = 0) -> list[Verdict]:
    """Compare so many problems that have a covariance."""
    verdicts: list[Verdict] = []
    while len(verdicts) < count:
        verdict = compare(seed)
        seed += 1
        if verdict is not None:
            verdicts.append(verdict)
    return verdicts


def main() -> int:
    """Print what is worst: 0 if nothing is above the limit."""
    count = int(sys.argv[1])
    verdicts = campaign(count, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    verdicts.sort(key=lambda verdict: -verdict.error)
    wrong = [verdict for verdict in verdicts if not verdict.error < LIMIT]
    for verdict in wrong or verdicts[:5]:
        print(f"{verdict.error:.1e} {verdict.of}, seed {verdict.seed}: {verdict.settings}")
    for robust in ("weights", "sandwich"):
        of = [v.error for v in verdicts if v.settings.get("robust", "weights") == robust]
        print(f"{robust}: {len(of)} problems, worst {max(of, default=0):.1e}")
    print(f"{count} problems, {len(wrong)} above {LIMIT:g}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
