"""Check of a user-defined residual at sample points: both references, verdicts, findings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import as_array, as_flag, refuse_row
from bundle.base.words import plural
from bundle.checking.classify import classify, float_precision, is_single, stale
from bundle.checking.evidence import EXPLAINED, Evidence, Finding, join_names
from bundle.checking.function import ResidualFunction, UserFunction
from bundle.checking.gradient_report import GradientCheckerSummary, GradientReport, Offender
from bundle.checking.jacobian_deviation import Array, JacobianDeviation
from bundle.checking.residual_blocks import Block, Column, Layout, ManifoldLike, Name, sample
from bundle.checking.step_curve import CheckDetails, Probe, SampleLines, SamplePoint, make_details
from bundle.checking.tally import Tally, make_report, undecided_points
from bundle.errors import InputError
from bundle.interface.analysis_options import TOLERANCE
from bundle.interface.option_fields import number

SAME_RESIDUAL = 1e-9
"""Largest difference between residuals of two calls at one point, relative to the largest entry."""

SINGLE_TOLERANCE = 1e-4
"""Relative error to which differences of a residual in single precision decide."""

SINGLE_ROUNDING = float(np.finfo(np.float32).eps / np.finfo(np.float64).eps)
"""Ratio of the rounding errors of single and double precision."""

ROUGH = 1e-3
"""Largest relative uncertainty of the reference that rounding can cause at the given point."""


def check_samples(
    samples: Sequence[SamplePoint],
    layout: Layout,
    *,
    tolerance: float,
    ambient: bool = True,
    details: bool = False,
) -> GradientReport:
    """Check Jacobians at sample points; the first sample is the point given by the user."""
    check = _Check(samples, layout, tolerance, ambient)
    report = check.run()
    return replace(report, details=check.details()) if details else report


class _Check:
    """A check; its methods are in the order of its steps."""

    def __init__(
        self, samples: Sequence[SamplePoint], layout: Layout, tolerance: float, ambient: bool
    ) -> None:
        self.layout, self.tolerance = layout, tolerance
        self.watched: tuple[JacobianDeviation, Sequence[int]] | None = None
        self.user = samples[0].user
        self.ambient = ambient or not layout.is_curved
        # Evaluate the samples in sequence and before all else, to detect a stale cache.
        first = [at.evaluate() for at in samples]
        finite = [bool(np.isfinite(residual).all()) for residual, _ in first]
        self.num_skipped = finite.count(False)
        self.has_start = finite[0]
        self.samples = [at for at, valid in zip(samples, finite, strict=True) if valid]
        self.residuals = [r for (r, _), valid in zip(first, finite, strict=True) if valid]
        self.jacobians = [j for (_, j), valid in zip(first, finite, strict=True) if valid]
        self.is_single = is_single(self.residuals) or (
            bool(self.samples) and self.samples[0].rounds_to_single()
        )
        if self.is_single:
            self.tolerance = max(tolerance, SINGLE_TOLERANCE)

    def run(self) -> GradientReport:
        """Compare with both references and report."""
        if not self.samples:
            words = "the residual is not a finite number at any sample"
            return self._report([], [Finding("not_finite", (), words)], GradientCheckerSummary())
        repeated_calls = [at.evaluate() for at in self.samples]
        unstable = _unstable(self.residuals, [residual for residual, _ in repeated_calls])
        if unstable is not None:
            return self._report([], [unstable], GradientCheckerSummary())
        again = [jacobian for _, jacobian in repeated_calls]
        references = [
            at.reference(self.layout.core, self._minuends(k)) for k, at in enumerate(self.samples)
        ]
        checker = [at.probe(self.layout.core) for at in self.samples]
        values, doubts, tangents, tangent_doubts = map(np.array, zip(*references, strict=True))
        space = JacobianDeviation(np.array(self.jacobians), values, doubts, self.tolerance)
        repeated = JacobianDeviation(np.array(again), values, doubts, self.tolerance)
        tangent, projected = space, list(range(len(space)))
        if self.layout.is_curved:
            projected = [k for k, probe in enumerate(checker) if probe[1] is not None]
            local = [probe[1] for probe in checker if probe[1] is not None]
            shape = (0, *tangents.shape[1:])
            tangent = JacobianDeviation(
                np.array(local) if local else np.zeros(shape),
                tangents[projected],
                tangent_doubts[projected],
                self.tolerance,
            )
        lines = SampleLines(self.samples, self.residuals, self.layout)
        space = lines.appealed(space, range(len(space)), self.tolerance, along_manifold=False)
        repeated = JacobianDeviation(
            repeated.analytic, space.reference, space.uncertainty, self.tolerance
        )
        tangent = (
            lines.appealed(tangent, projected, self.tolerance, along_manifold=True)
            if self.layout.is_curved
            else space
        )
        tallies, findings = self._findings(space, repeated, tangent, np.array(projected, np.intp))
        watched = space if self.ambient else tangent
        numbers = range(len(space)) if self.ambient else projected
        if not findings:
            findings = self._undecided_start(watched, numbers)
        undecided = self._undecided(watched, numbers)
        self.watched = watched, numbers
        return self._report(tallies, findings, self._summary(space, checker), undecided)

    def details(self) -> tuple[CheckDetails, ...]:
        """Return errors of all entries and curves of selected ones; () if nothing was compared."""
        if self.watched is None:
            return ()
        deviations, numbers = self.watched
        lines = SampleLines(self.samples, self.residuals, self.layout)
        columns = self.layout.columns if self.ambient else self.layout.tangent_columns
        details = make_details(
            [column.name for column in columns],
            [column.group for column in columns],
            deviations,
            self.tolerance,
            lambda k, j: lines.line(numbers[k], j, along_manifold=not self.ambient),
            lambda k: f"sample {numbers[k]}",
        )
        return (details,)

    def _minuends(self, k: int) -> Sequence[float]:
        """Return sizes of doubles that round as the residuals do in single precision."""
        if not self.is_single:
            return ()
        moved = np.abs(self.jacobians[k] * np.concatenate(self.samples[k].blocks))
        moved = np.where(np.isfinite(moved), moved, 0.0).max(axis=1)
        return [*map(float, SINGLE_ROUNDING * np.maximum(np.abs(self.residuals[k]), moved))]

    def _undecided_start(
        self, deviations: JacobianDeviation, samples: Sequence[int]
    ) -> list[Finding]:
        """Return a finding if the given (first) point is on a kink or a jump."""
        if not self.has_start or not len(samples) or samples[0] != 0:
            return []
        doubt = self._roughness(deviations)
        columns = self.layout.columns if self.ambient else self.layout.tangent_columns
        rough = [columns[j].name for j in np.flatnonzero((doubt > ROUGH).any(axis=0))]
        if not rough:
            return []
        return [
            Finding(
                "undecided",
                tuple(rough),
                f"{join_names(rough)}: the given point is on a kink, a jump or the border of "
                "the residual's domain: the derivative there is undecided",
            )
        ]

    @staticmethod
    def _roughness(deviations: JacobianDeviation) -> Array:
        """Return (R, N) uncertainties at the first point, by the larger of scale and row."""
        row = np.abs(deviations.reference[0]).max(axis=1, keepdims=True)
        rough: Array = deviations.uncertainty[0] / np.maximum(deviations.scale[0], row)
        return rough

    def _undecided(
        self, deviations: JacobianDeviation, samples: Sequence[int]
    ) -> dict[str, list[int]]:
        """Return the samples without a mistake at which most entries have no accurate reference."""
        found: dict[str, list[int]] = {"no_value": [], "rough": []}
        for k, index in enumerate(samples):
            doubt = deviations.doubt[k]
            is_start = index == 0 and self.has_start
            is_rough = is_start and bool((self._roughness(deviations) > ROUGH).any())
            known = (doubt <= self.tolerance).mean() >= 0.5 and not is_rough
            if known or (deviations.error[k] > self.tolerance).any():
                continue
            found["no_value" if np.isinf(doubt).any() else "rough"].append(index)
        return found

    def _findings(
        self,
        space: JacobianDeviation,
        repeated: JacobianDeviation,
        tangent: JacobianDeviation,
        projected: NDArray[np.intp],
    ) -> tuple[list[Tally], list[Finding]]:
        layout, tolerance = self.layout, self.tolerance
        along = Tally(layout.tangent_columns, tolerance)
        along.add(tangent, projected)
        tallies = [along]
        outer = Tally(layout.columns, tolerance)
        outer.add(space, np.arange(len(space)))
        if layout.is_curved and self.ambient:
            tallies.append(outer)
        watched = outer if self.ambient else along
        if not watched.wrong_columns and not along.wrong_columns:
            rounded = float_precision(space, tuple(c.name for c in layout.columns))
            is_precise = rounded is not None and tolerance <= TOLERANCE
            return tallies, [rounded] if rounded is not None and is_precise else []
        whole = stale(space, repeated, tolerance)
        if whole is None and not self.is_single:
            whole = float_precision(space, tuple(c.name for c in layout.columns))
        if whole is not None:
            return tallies, [whole]
        if layout.is_curved and self.ambient and not along.wrong_columns:
            return tallies, [self._normal(outer)]
        if layout.is_curved and self.ambient and len(projected) == len(space):
            found = padded(layout, space, tangent, tolerance)
            if found:
                return tallies, found
        findings = self._classify(outer, layout.columns, layout.blocks, ambient=True)
        if layout.is_curved:
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
        points = np.array([np.concatenate(self.samples[int(k)].blocks) for k in kept.points])
        if len(self.layout.is_step):
            points[:, self.layout.is_step] = 0.0
        if not ambient and self.layout.is_curved:
            points = np.zeros((len(points), len(columns)))

        def reference_at(k: int, parameter: int) -> Array | None:
            at = self.samples[int(kept.points[k])]
            return at.reference_without(parameter, self.layout.core)

        evidence = Evidence(
            kept.deviations,
            columns,
            blocks,
            points,
            reference_at,
            tally.wrong_columns,
            self.tolerance,
            numbers=kept.points,
            residuals=np.array([self.residuals[int(k)] for k in kept.points]),
        )
        return classify(evidence)

    def _normal(self, outer: Tally) -> Finding:
        names = tuple(outer.columns[j].name for j in outer.wrong_columns)
        return Finding(
            "normal",
            names,
            f"{join_names(names)}: right along the manifold, wrong along its normal, which "
            "ceres::GradientChecker does not test and which does not affect a solve "
            "(ambient=False accepts it)",
            float(outer.max_error.max()),
        )

    def _summary(
        self, space: JacobianDeviation, checker: Sequence[Probe]
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
        findings: Sequence[Finding],
        summary: GradientCheckerSummary,
        undecided: Mapping[str, Sequence[int]] = MappingProxyType({}),
    ) -> GradientReport:
        worst = [
            Offender(
                f"sample {entry.point}",
                tally.columns[entry.column].name,
                entry.residual,
                entry.analytic,
                entry.reference,
                entry.error,
                {"sample": entry.point},
            )
            for tally in tallies
            for entry in tally.worst
        ]
        sizes = " + ".join(map(str, self.user.sizes))
        parameters = "parameter" if sizes == "1" else "parameters"
        residuals = plural(self.user.num_residuals, "residual")
        single = " in single precision" if self.is_single else ""
        return make_report(
            subject=f"a function of {sizes} {parameters} with {residuals}{single}",
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


def _unstable(first: Sequence[Array], again: Sequence[Array]) -> Finding | None:
    """Return a finding if two calls at one point differ by more than rounding errors."""
    for k, (one, other) in enumerate(zip(first, again, strict=True)):
        with np.errstate(invalid="ignore"):
            same = np.abs(one - other) <= SAME_RESIDUAL * np.abs(one).max()
        if not same.all():
            row = int(np.flatnonzero(~same)[0])
            return Finding(
                "unstable",
                (),
                f"the function is not deterministic: two calls at sample {k} give residual "
                f"{row} as {one[row]:.9g} and {other[row]:.9g}; its Jacobians are undecided",
            )
    return None


def _vagueness(findings: Sequence[Finding]) -> int:
    if not findings:
        return 100
    return sum(f.kind in ("small_part", "large_part", "order", "missing_term") for f in findings)


# Signature: tangent Jacobians padded with a column of zeros to the size of the block.
#
# Older solvers expect a Jacobian w.r.t. the parameters of a block (4 for a quaternion). They
# multiply it by the Jacobian of the manifold's Plus. If the Plus Jacobian is (I, 0)^T, the tangent
# Jacobian with a zero column is correct. For any other manifold it is wrong.

SCALES = (1.0, 2.0, 0.5)
"""Scales of tangent coordinates: a rotation vector, or twice or half a quaternion's vector part."""


def padded(
    layout: Layout, space: JacobianDeviation, tangent: JacobianDeviation, tolerance: float
) -> list[Finding]:
    """Return one finding per padded block if no other mistake exists.

    ``space``: Jacobians by the parameters of the blocks. ``tangent``: Jacobians by the tangent
    coordinates, at the same points.
    """
    wrong = set(np.flatnonzero((space.error > tolerance).any(axis=(0, 1))).tolist())
    findings = []
    first = first_tangent = 0
    for manifold in layout.manifolds:
        columns = list(range(first, first + manifold.size))
        moves = slice(first_tangent, first_tangent + manifold.tangent_size)
        first, first_tangent = first + manifold.size, first_tangent + manifold.tangent_size
        if manifold.tangent_size != manifold.size - 1 or not wrong & set(columns):
            continue
        given = space.analytic[..., columns]
        names = [layout.columns[j].name for j in columns]
        for place in np.flatnonzero(~given.any(axis=(0, 1))):
            if not _is_tangent(np.delete(given, place, axis=2), tangent.reference[..., moves]):
                continue
            wrong -= set(columns)
            findings.append(
                Finding(
                    "padded",
                    tuple(names),
                    f"{join_names(names)}: the Jacobian w.r.t. the {manifold.tangent_size} tangent "
                    f"coordinates, padded with a zero column ({names[place]}), not w.r.t. "
                    f"the {manifold.size} numbers of the block",
                    float(space.error[..., columns].max()),
                )
            )
            break
    return [] if wrong else findings


def _is_tangent(given: Array, reference: Array) -> bool:
    """Return True if columns are derivatives w.r.t. tangent coordinates, up to scale or rotation.

    Rotations and translations have three columns each. Their perturbation may be from the other
    side; then the columns are A Q with a rotation Q, and A A^T does not change.
    """
    parts = [slice(j, j + 3) for j in range(0, given.shape[2], 3)]
    for part in parts:
        right = reference[..., part]
        size = np.linalg.norm(right)
        products = right @ right.transpose(0, 2, 1)
        found = given[..., part] @ given[..., part].transpose(0, 2, 1)
        if not any(
            np.linalg.norm(found - scale**2 * products) <= EXPLAINED * size**2 * scale**2
            for scale in SCALES
        ):
            return False
    return True


def check_function_at(
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
    details: bool = False,
) -> GradientReport:
    """Check the Jacobians of a function; see :func:`bundle.check_gradients`."""
    UserFunction.check_call(function, blocks)
    start: list[Array] = [as_array("blocks", block).reshape(-1).copy() for block in blocks]
    if not start or not all(len(block) for block in start):
        raise InputError("blocks: expected at least one block, and no empty block")
    refuse_row(
        [not np.isfinite(block).all() for block in start],
        lambda b: f"blocks: expected finite numbers, found nan or infinity in block {b}",
    )
    num_samples = number("num_samples", num_samples, minimum=1, whole=True)
    radius = number("radius", radius, minimum=0)
    ambient = as_flag("ambient", ambient)
    seed = number("seed", seed, minimum=0, maximum=math.inf, whole=True)
    tolerance = number("tolerance", tolerance, above=0)
    layout = Layout.make(start, manifolds, names)
    user = UserFunction.at(function, start)
    rng = np.random.default_rng(seed)
    samples = [SamplePoint(user, start)]
    for _ in range(num_samples - 1):
        around = [
            sample(manifold, block, radius, rng)
            for manifold, block in zip(layout.manifolds, start, strict=True)
        ]
        samples.append(SamplePoint(user, around))
    return check_samples(
        samples, layout, tolerance=tolerance, ambient=ambient, details=as_flag("details", details)
    )
