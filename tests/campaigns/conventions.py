"""Mistakes of Jacobians in the layouts of Ceres, GTSAM, manif and g2o, each to be named.

python -m tests.campaigns.conventions [ROUNDS] [RIGHT] [SEED]

The mistakes of `library_mistakes`, each ROUNDS times at random values of each scale, and RIGHT
right Jacobians of `right_jacobians`. At least 55 of 60 are to be named, no right one accused.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

import bundle
from tests.campaigns.library_mistakes import Mistake, listed
from tests.campaigns.library_residuals import Residual, in_library
from tests.campaigns.right_jacobians import draw

SCALES = ({}, {"scale": 1e3}, {"scale": 10.0, "offset": 4e5})
"""Units of metres, millimetres, and coordinates of a map."""


def check(library, residual, **settings):
    """Check a residual in the layout of a library."""
    if library == "ceres":
        return bundle.check_gradients(
            residual.function, residual.values, residual.manifolds, **settings
        )
    return bundle.check_gradients(
        residual.function, residual.values, residual.manifolds, tangent=library, **settings
    )


def planted(mistake: Mistake, rng, **scales: float) -> Residual:
    """A residual with a mistake."""
    plain = mistake.make(rng, **scales)
    inner = plain.function
    right = plain if mistake.library == "ceres" else in_library(plain, mistake.library)

    def function(values):
        error, jacobians = right.function(values)
        if mistake.spoil.__code__.co_argcount == 4:
            return error, mistake.spoil(values, jacobians, error, _as_given(right, inner))
        return error, mistake.spoil(values, jacobians, error)

    return right._replace(function=function)


def _as_given(right, inner):
    """The right function, with the weights of the inner one."""

    def function(values):
        return right.function(values)

    function.weights = getattr(inner, "weights", None)
    return function


class Verdict(NamedTuple):
    """Verdict on a case."""

    name: str
    expected: frozenset[str]
    verdict: str
    kinds: frozenset[str]

    @property
    def is_named(self) -> bool:
        """True if the checker names the mistake, and no other."""
        return self.verdict == "wrong" and self.kinds == self.expected


def judge(mistake: Mistake, seed: int, **scales: float) -> Verdict:
    """Check a mistake at random values."""
    residual = planted(mistake, np.random.default_rng(seed), **scales)
    report = check(mistake.library, residual, num_samples=3, seed=seed)
    name = f"{mistake.library}: {mistake.name}"
    return Verdict(name, mistake.kinds, report.verdict, report.kinds)


def judge_right(seed: int) -> Verdict:
    """Check a right residual under stress."""
    library, name, residual = draw(np.random.default_rng(seed))
    report = check(library, residual, num_samples=3, seed=seed)
    return Verdict(f"{library}: {name}", frozenset({"correct"}), report.verdict, report.kinds)


def main(arguments: list[str]) -> int:
    """Print what went wrong; exit with 1 if too many mistakes are unnamed or one is accused."""
    rounds, num_right, seed = [*map(int, arguments), *(1, 200, 0)[len(arguments) :]]
    mistakes = listed()
    fewest = len(mistakes)
    for scales in SCALES:
        for k in range(seed, seed + rounds):
            verdicts = [judge(mistake, k, **scales) for mistake in mistakes]
            named = sum(verdict.is_named for verdict in verdicts)
            fewest = min(fewest, named)
            print(f"seed {k}, {scales}: {named} of {len(mistakes)} named")
            _print(verdict for verdict in verdicts if not verdict.is_named)
    rights = [judge_right(seed + k) for k in range(num_right)]
    accused = [verdict for verdict in rights if verdict.verdict == "wrong"]
    undecided = [verdict for verdict in rights if verdict.verdict == "undecided"]
    print(f"{len(accused)} of {num_right} right ones accused, {len(undecided)} undecided")
    _print([*accused, *undecided])
    return int(bool(accused) or fewest < len(mistakes) * 55 / 60)


def _print(verdicts) -> None:
    for verdict in verdicts:
        found = ", ".join(sorted(verdict.kinds))
        expected = ", ".join(sorted(verdict.expected))
        print(f"  {verdict.name}: {verdict.verdict}, {found} (expected {expected})")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
