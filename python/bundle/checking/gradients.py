"""Checking the Jacobians of a user's residual."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from bundle import _core
from bundle.arguments import as_array, as_flag
from bundle.check_defaults import TOLERANCE
from bundle.checking.assemble import CHECKER_PRECISION, make_report, undecided_points
from bundle.checking.classify import classify, float_precision, stale
from bundle.checking.columns import Block, Column
from bundle.checking.evidence import Evidence, Finding, join_names
from bundle.checking.function import ResidualFunction, UserFunction
from bundle.checking.gradient_report import GradientCheckerSummary, GradientReport, Offender
from bundle.checking.jacobian_deviation import Array, JacobianDeviation
from bundle.checking.manifolds import ManifoldLike
from bundle.checking.residual_blocks import Layout, Name, sample
from bundle.checking.tally import Tally
from bundle.errors import InputError, brief
from bundle.option_fields import number

__all__ = ["check_gradients"]

SAME_RESIDUAL = 1e-9
"""By how much of its largest entry a residual may differ between two calls at the same point."""

_Probe = tuple[bool, Array | None, Array | None, str]


def check_gradients(
    function: ResidualFunction,
    blocks: Sequence[ArrayLike],
    manifolds: Sequence[ManifoldLike] | None = None,
    *,
    names: Sequence[Name] | None = None,
    num_samples: int = 10,
    radius: float = 0.1,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    ambient: bool = True,
) -> GradientReport:
    """Check analytic Jacobians, and say what is wrong with them.

    At the given point and at others around it the Jacobians are compared with two references:
    ceres::GradientChecker, and central differences with Richardson extrapolation that bound their
    own error. In a test::

        assert bundle.check_gradients(residual, [pose, intrinsics, point], ["se3", None, None])

    Args:
        function: takes a list of arrays, one per block, and returns (residual, list of Jacobians),
            Jacobian i of shape (num_residuals, size of block i). It is called some hundred times
            for each sample and block. The C++ header bundle/check.h (``bundle.get_include()``)
            makes one of a compiled ceres cost function.
        blocks: the parameters, one array a block.
        manifolds: one per block, or None where all are Euclidean: None or "euclidean"; "angle_axis"
            (a rotation vector: its numbers are a vector space, but they are sampled and named as a
            rotation); "quaternion_wxyz", "quaternion_xyzw"; "se3" (qx qy qz qw tx ty tz, as COLMAP
            stores a pose); "sphere"; ("subset", entries that stay constant).
        names: one per block, for the report: a name, or (name, names of its parameters).
        num_samples: points to check, the given one included.
        radius: how far the others are, relative to each parameter; radians for rotations.
        seed: of the sampling.
        tolerance: relative error from which on an entry is wrong.
        ambient: also compare along the normals of manifolds, which a solve does not feel and
            GradientChecker does not see.

    Returns:
        A report that is true if all is well, and explains itself when printed.

    Raises:
        InputError: blocks, manifolds or names do not fit each other, or the function answers with
            wrong shapes. What the function raises comes through.
    """
    if not callable(function):
        raise InputError(f"function: expected a function, found {brief(function)}")
    single = isinstance(blocks, np.ndarray) and blocks.ndim == 0
    if isinstance(blocks, str | bytes | Mapping) or not isinstance(blocks, Iterable) or single:
        raise InputError(f"blocks: expected a list of arrays, found {brief(blocks)}")
    start = [as_array("blocks", block).reshape(-1).copy() for block in blocks]
    if not start or not all(len(block) for block in start):
        raise InputError("blocks: expected at least one block, none of them empty")
    for b, block in enumerate(start):
        if not np.isfinite(block).all():
            raise InputError(f"blocks: expected finite numbers, found others in block {b}")
    num_samples = number("num_samples", num_samples, minimum=1, whole=True)
    radius = number("radius", radius, minimum=0)
    ambient = as_flag("ambient", ambient)
    seed = number("seed", seed, minimum=0, maximum=math.inf, whole=True)
    tolerance = number("tolerance", tolerance, above=0)
    layout = Layout.make(start, manifolds, names)
    user = UserFunction(function, start)
    rng = np.random.default_rng(seed)
    samples = [start]
    for _ in range(num_samples - 1):
        samples.append([
            sample(manifold, block, radius, rng)
            for manifold, block in zip(layout.manifolds, start, strict=True)
        ])  # fmt: skip
    return _Check(user, layout, samples, tolerance, ambient).run()


class _Check:
    """One check, in the order of its methods."""

    def __init__(
        self,
        user: UserFunction,
        layout: Layout,
        samples: Sequence[list[Array]],
        tolerance: float,
        ambient: bool,
    ) -> None:
        self.user, self.layout, self.tolerance = user, layout, tolerance
        self.ambient = ambient or not layout.is_curved
        # One after the other, so that a cache that lags behind shows, and before anything else.
        first = [user.evaluate(blocks) for blocks in samples]
        finite = [bool(np.isfinite(residual).all()) for residual, _ in first]
        self.num_skipped = finite.count(False)
        self.samples = [blocks for blocks, valid in zip(samples, finite, strict=True) if valid]
        self.residuals = [r for (r, _), valid in zip(first, finite, strict=True) if valid]
        self.jacobians = [j for (_, j), valid in zip(first, finite, strict=True) if valid]

    def run(self) -> GradientReport:
        """Compare with both references and report."""
        if not self.samples:
            return self._report([], [], [_no_value()], GradientCheckerSummary())
        repeated_calls = [self.user.evaluate(blocks) for blocks in self.samples]
        unstable = _unstable(self.residuals, [residual for residual, _ in repeated_calls])
        if unstable is not None:
            return self._report([], [], [unstable], GradientCheckerSummary())
        again = [jacobian for _, jacobian in repeated_calls]
        references = [
            _core.richardson_jacobian(self.user.core, self.user.num_residuals, x, self.layout.core)
            for x in self.samples
        ]
        checker = [
            _core.gradient_checker(
                self.user.core, self.user.num_residuals, x, self.layout.core, CHECKER_PRECISION
            )
            for x in self.samples
        ]
        values, doubts, tangents, tangent_doubts = map(np.array, zip(*references, strict=True))
        space = JacobianDeviation(np.array(self.jacobians), values, doubts)
        repeated = JacobianDeviation(np.array(again), values, doubts)
        tangent, projected = space, list(range(len(space)))
        if self.layout.is_curved:
            projected = [k for k, probe in enumerate(checker) if probe[1] is not None]
            local = [probe[1] for probe in checker if probe[1] is not None]
            shape = (0, *tangents.shape[1:])
            tangent = JacobianDeviation(
                np.array(local) if local else np.zeros(shape),
                tangents[projected],
                tangent_doubts[projected],
            )
        tallies, findings = self._findings(space, repeated, tangent)
        watched = space if self.ambient else tangent
        numbers = range(len(space)) if self.ambient else projected
        undecided = self._undecided(watched, numbers)
        return self._report(tallies, projected, findings, self._summary(space, checker), undecided)

    def _undecided(
        self, deviations: JacobianDeviation, samples: Sequence[int]
    ) -> dict[str, list[int]]:
        """Return the samples at which most entries have no good reference and none is wrong."""
        found: dict[str, list[int]] = {"no_value": [], "rough": []}
        for k, index in enumerate(samples):
            doubt = deviations.doubt[k]
            if (deviations.error[k] > self.tolerance).any() or (
                (doubt <= self.tolerance).mean() >= 0.5
            ):
                continue
            found["no_value" if np.isinf(doubt).any() else "rough"].append(index)
        return found

    def _findings(
        self, space: JacobianDeviation, repeated: JacobianDeviation, tangent: JacobianDeviation
    ) -> tuple[list[Tally], list[Finding]]:
        layout, tolerance = self.layout, self.tolerance
        along = Tally(layout.tangent_columns, tolerance)
        along.add(tangent, np.arange(len(tangent)))
        tallies = [along]
        outer = Tally(layout.columns, tolerance)
        outer.add(space, np.arange(len(space)))
        if layout.is_curved and self.ambient:
            tallies.append(outer)
        watched = outer if self.ambient else along
        if not watched.wrong_columns and not along.wrong_columns:
            rounded = float_precision(space, tuple(c.name for c in layout.columns))
            single = rounded is not None and tolerance <= TOLERANCE
            return tallies, [rounded] if rounded is not None and single else []
        whole = stale(space, repeated, tolerance)
        if whole is None:
            whole = float_precision(space, tuple(c.name for c in layout.columns))
        if whole is not None:
            return tallies, [whole]
        if layout.is_curved and self.ambient and not along.wrong_columns:
            return tallies, [self._normal(outer)]
        findings = self._classify(outer, layout.columns, layout.blocks, ambient=True)
        if layout.is_curved and along.wrong_columns:
            inner = self._classify(
                along, layout.tangent_columns, layout.tangent_blocks, ambient=False
            )
            if not self.ambient or _vagueness(inner) < _vagueness(findings):
                findings = inner
        return tallies, findings

    def _classify(
        self, tally: Tally, columns: Sequence[Column], blocks: Sequence[Block], *, ambient: bool
    ) -> list[Finding]:
        kept = tally.kept
        if kept is None:
            return []
        points = np.array([np.concatenate(self.samples[int(k)]) for k in kept.points])
        if not ambient and self.layout.is_curved:
            points = np.zeros((len(points), len(columns)))

        def reference_at(k: int, parameter: int) -> Array | None:
            flat = points[k].copy()
            flat[parameter] = 0.0
            x = np.split(flat, np.cumsum(self.user.sizes)[:-1])
            if self.user.core(x, False) is None:
                return None
            found = _core.richardson_jacobian(
                self.user.core, self.user.num_residuals, x, self.layout.core
            )
            return found[0] if np.isfinite(found[1]).all() else None

        evidence = Evidence(
            kept.deviations,
            columns,
            blocks,
            points,
            reference_at,
            tally.wrong_columns,
            self.tolerance,
        )
        return classify(evidence)

    def _normal(self, outer: Tally) -> Finding:
        names = tuple(outer.columns[j].name for j in outer.wrong_columns)
        return Finding(
            "normal",
            names,
            f"{join_names(names)}: right along the manifold, wrong along its normal, where "
            "ceres::GradientChecker does not look; a solve does not feel it "
            "(ambient=False accepts it)",
            float(outer.max_error.max()),
        )

    def _summary(
        self, space: JacobianDeviation, checker: Sequence[_Probe]
    ) -> GradientCheckerSummary:
        wrong = (space.error > self.tolerance).any(axis=(1, 2))
        agreed = np.array([bool(probe[0]) for probe in checker])
        gave_up = np.array([probe[1] is None for probe in checker])
        return GradientCheckerSummary(
            num_probes=len(checker),
            num_agreed=int(agreed.sum()),
            num_false_alarms=int((~agreed & ~gave_up & ~wrong).sum()),
            num_gave_up=int(gave_up.sum()),
            num_overlooked=int((agreed & wrong).sum()),
        )

    def _report(
        self,
        tallies: Sequence[Tally],
        projected: Sequence[int],
        findings: Sequence[Finding],
        summary: GradientCheckerSummary,
        undecided: Mapping[str, Sequence[int]] = MappingProxyType({}),
    ) -> GradientReport:
        worst = [
            Offender(
                f"sample {projected[entry.point] if t == 0 else entry.point}",
                tally.columns[entry.column].name,
                entry.residual,
                entry.analytic,
                entry.reference,
                entry.error,
                {"sample": projected[entry.point] if t == 0 else entry.point},
            )
            for t, tally in enumerate(tallies)
            for entry in tally.worst
        ]
        sizes = " + ".join(map(str, self.user.sizes))
        return make_report(
            subject=f"a function of {sizes} parameters with {self.user.num_residuals} residuals",
            noun="sample",
            tallies=tallies,
            findings=findings,
            worst=worst,
            num_checked=len(self.samples),
            num_skipped=self.num_skipped,
            gradient_checker=summary,
            tolerance=self.tolerance,
            undecided=undecided_points("sample", undecided, lambda k: f"sample {k}"),
        )


def _no_value() -> Finding:
    return Finding("not_finite", (), "the residual is not a finite number at any sample")


def _unstable(first: Sequence[Array], again: Sequence[Array]) -> Finding | None:
    """Return a finding if two calls at one point differ by more than a sum's order explains."""
    for k, (one, other) in enumerate(zip(first, again, strict=True)):
        with np.errstate(invalid="ignore"):
            same = np.abs(one - other) <= SAME_RESIDUAL * np.abs(one).max()
        if not same.all():
            row = int(np.flatnonzero(~same)[0])
            return Finding(
                "unstable",
                (),
                f"the function is not deterministic: two calls at sample {k} give residual {row} "
                f"as {one[row]:.9g} and {other[row]:.9g}; nothing can be said of its Jacobians",
            )
    return None


def _vagueness(findings: Sequence[Finding]) -> int:
    """Return how many findings say no more than that something is wrong."""
    if not findings:
        return 100
    return sum(f.kind in ("small_part", "large_part", "order", "missing_term") for f in findings)
