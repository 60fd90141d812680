"""Covariances of random problems against the dense pseudo-inverse of J, block by block.

Random problems (tests/analysis/uncertainty/random_problems) have rigs, ties, priors, fixed parts
and losses. Where more than similarities is free, or a loss rejects too much for a sandwich, both
have to say so. Printed beside each: what sums of squares would round (Dense.rounding), a sandwich
twice; covariances of small problems do without these.

python -m tests.campaigns.covariance COUNT [SEED]
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

import bundle
from tests.analysis.uncertainty.dense import SingularError
from tests.analysis.uncertainty.random_problems import random_case
from tests.analysis.uncertainty.test_covariance import compare

TOLERANCE = 1e-8  # in sigmas
TIMES_ROUNDING = 2


class Comparison(NamedTuple):
    """The largest difference of a covariance's entries, in the sigmas of its dense form."""

    seed: int
    robust: str
    kind: str
    difference: float
    rounding: float

    @property
    def is_wrong(self) -> bool:
        """Return whether the difference exceeds rounding."""
        return not self.difference <= max(TOLERANCE, TIMES_ROUNDING * self.rounding)


def compare_seed(seed: int, **given: bool) -> list[Comparison]:
    """Compare one problem, by weights and, where it has one, by its sandwich."""
    case = random_case(seed, **given)
    found = []
    for robust in ("weights", *(() if case.joins_points else ("sandwich",))):
        try:
            cov = bundle.covariance(
                case.problem, robust=robust, factors=case.factors, num_threads=1, **case.settings
            )
        except bundle.InputError:
            cov = None
        bent = robust == "sandwich"
        try:
            dense = case.dense.covariance(case.basis, sandwich=bent, num_priors=case.num_prior_rows)
        except SingularError:  # points without parallax are named, the rest is given
            is_said = cov is None or len(cov.null_point_ids) > 0
            found.append(Comparison(seed, robust, "singular", 0.0 if is_said else np.inf, 0.0))
            continue
        rounding = case.dense.rounding(case.basis, sandwich=bent, num_priors=case.num_prior_rows)
        worst = {"refused": np.inf} if cov is None else compare(case, dense, cov)
        kind = max(worst, key=lambda name: worst[name])
        found.append(Comparison(seed, robust, kind, float(worst[kind]), float(rounding)))
    return found


def campaign(count: int, seed: int = 0) -> list[Comparison]:
    """Compare so many problems."""
    return [entry for n in range(seed, seed + count) for entry in compare_seed(n)]


def main() -> int:
    """Print the largest differences: 0 if rounding explains all."""
    count = int(sys.argv[1])
    found = campaign(count, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    found.sort(key=lambda entry: -entry.difference)
    for robust in ("weights", "sandwich"):
        for entry in [entry for entry in found if entry.robust == robust][:5]:
            print(
                f"{robust}: seed {entry.seed}, {entry.kind}: {entry.difference:.2g} sigmas, "
                f"rounding {entry.rounding:.2g}"
            )
    wrong = [entry for entry in found if entry.is_wrong]
    singular = sum(entry.kind == "singular" and not entry.is_wrong for entry in found)
    close = sum(entry.difference <= TOLERANCE for entry in found)
    print(
        f"{count} problems, {len(found)} covariances, {close} within {TOLERANCE} "
        f"({singular} singular for both), {len(wrong)} wrong"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
