"""Covariances of a reconstruction at its own values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.analysis.uncertainty.value_checks import (
    check_same_factors,
    note_on_far_points,
    refuse_huge,
    refuse_rounding,
    rows_of,
)
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.base.words import not_converged
from bundle.errors import InputError
from bundle.interface.covariance_options import GAUGES, ROBUST, SCALES, one_of, parts_of
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.placed_problem import Prior
    from bundle.solving.request import Rules

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""


def problem_covariance(
    problem: Source | Result,
    options: SolveOptions | None,
    *,
    of: str | Iterable[str],
    relative: Iterable[tuple[int, int]],
    gauge: str,
    scale: str,
    robust: str,
    factors: Iterable[Factor],
    priors: Iterable[Prior],
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None,
    constraints: Constraints | Iterable[str | Rule],
    changes: dict[str, Any],
) -> Covariance:
    """Compute the covariances of a reconstruction; see :func:`bundle.covariance`."""
    if isinstance(problem, Result):
        check_same_factors(problem, factors, priors, constraints)
        options = problem.options if options is None else options
        problem = problem.problem
    problem = as_problem(problem)
    options = SolveOptions.of(options, changes, "covariance")
    gauge = one_of("gauge", gauge, GAUGES)
    request = SolveRequest(
        problem=problem,
        options=options.replace(gauge="none" if gauge == "inner" else gauge),
        factors=factors,
        priors=priors,
        align=None,
        bounds=bounds,
        constraints=constraints if not isinstance(constraints, Iterable) else tuple(constraints),
    )
    recipe = _Recipe(
        request=request if not request.priors else replace(request, align=False),
        of=parts_of("of", of),
        gauge=gauge,
        scale=one_of("scale", scale, SCALES),
        robust=one_of("robust", robust, ROBUST),
    )
    if recipe.robust == "sandwich" and recipe.scale == "sigma0":
        raise InputError(
            "scale: expected unit with the sandwich, which takes its scale from the residuals"
        )
    return recipe.compute(list(relative))


def intrinsics_covariance(
    problem: Problem, options: SolveOptions, constraints: Rules = ()
) -> Covariance:
    """Return the covariance of the intrinsics, scaled by sigma0, as :func:`covariance` does.

    Sums are doubles also for small models: ten times faster, with fewer digits.

    Raises:
        InputError: as :func:`covariance`.
    """
    gauge = "two_cameras"  # intrinsics do not depend on it
    request = SolveRequest(
        problem=problem, options=options.replace(gauge=gauge), constraints=constraints
    )
    recipe = _Recipe(request, ("intrinsics",), gauge, "sigma0", "weights", long_sums=False)
    return recipe.compute([])


HARD_TWISTS = (
    "Hard twists leave out that a camera's motion differs from that of its neighbours: standard "
    "deviations are too small, those of readouts by a factor of about 5. Use tied twists."
)


@dataclass(frozen=True)
class _Recipe:
    """All inputs of a covariance; supports pickling."""

    request: SolveRequest
    of: tuple[str, ...]
    gauge: str
    scale: str
    robust: str
    long_sums: bool = True

    def __setstate__(self, state: dict[str, Any]) -> None:
        if "request" not in state:  # a pickle of an older version, without requests
            align = False if state["priors"] else None
            names = ("options", "factors", "priors", "bounds", "constraints")
            known = {name: state[name] for name in names}
            state = {name: state[name] for name in ("of", "gauge", "scale", "robust")} | {
                "request": SolveRequest(problem=state["given"], align=align, **known)
            }
        vars(self).update(state)

    def compute(self, pairs: list[tuple[int, int]]) -> Covariance:
        """Return the covariance, with the relative poses of these pairs of image ids."""
        given = self.request.problem
        rows = rows_of(given, pairs)
        if not given.num_observations:
            raise InputError("problem: expected observations, found 0")
        refuse_huge(given)
        ready = prepare(self.request)
        layout = ready.layout
        factors = layout.core_factors()

        def run(problem: Problem, options: SolveOptions) -> dict[str, Any]:
            return _core.covariance(
                problem,
                options.asdict(),
                layout.limits,
                factors,
                self.gauge == "inner",
                self.robust == "sandwich",
                "points" in self.of,
                rows,
                self.long_sums,
            )

        out = run(ready.start, layout.options)
        dof = out["num_residuals"] - out["num_parameters"] + out["gauge_degrees"]
        if dof < 0:  # a factor of rounding errors is meaningless
            raise InputError(
                "problem: expected at least as many residuals as parameters, found "
                f"{out['num_residuals']} for {out['num_parameters'] - out['gauge_degrees']} "
                "(bundle diagnose names the undetermined parameters)"
            )
        sigma0 = float(np.sqrt(out["weighted_squares"] / dof)) if dof > 0 else float("nan")
        notes = list(out["warnings"])
        if layout.options.twists == "hard":
            notes.append(HARD_TWISTS)
        if out["gauge_degrees"] > 0 and (
            far := note_on_far_points(ready.start, out["null_points"])
        ):
            notes.append(far)
        cost = 0.5 * out["weighted_squares"]
        # Control points start at the intersection of their rays, not at the result of a solve.
        if ready.placed.targets is None and out["predicted_decrease"] > AT_MINIMUM * cost:
            share = 100 * out["predicted_decrease"] / cost if cost > 0 else float("inf")
            notes.append(not_converged(share, layout.options.loss == "trivial"))
        factor = 1.0
        if self.scale == "sigma0":
            if not dof > 0:
                raise InputError(
                    f"scale: expected degrees of freedom to estimate sigma0 from, found {dof} "
                    f"({out['num_residuals']} residuals); use unit"
                )
            if factors is None:
                factor = sigma0 * sigma0
            else:
                out = run(*_scaled(ready.start, layout.options, sigma0))
        return self._result(out, pairs, dof, sigma0, factor, tuple(notes))

    def _result(
        self,
        out: dict[str, Any],
        pairs: list[tuple[int, int]],
        dof: int,
        sigma0: float,
        factor: float,
        notes: tuple[str, ...],
    ) -> Covariance:
        problem = self.request.problem
        refuse_rounding(problem, out)
        num_points = problem.num_points  # control points of the start follow them

        def some(part: str, ids: NDArray[Any], values: NDArray[Any]) -> tuple[Any, Any]:
            count = len(ids) if part in self.of else 0
            scaled = values[:count] if factor == 1 else freeze(values[:count] * factor)
            return freeze(np.array(ids[:count], np.int64)), scaled

        points = out.get("points", np.zeros((0, 3, 3)))
        sensors = np.stack([problem.sensor_rig_ids, problem.sensor_camera_ids], axis=1)
        names = {
            "pose": some("poses", problem.image_ids, out["poses"][: problem.num_images]),
            "frame": some("poses", problem.frame_ids, out["frames"]),
            "sensor": some("poses", sensors, out["sensors"]),
            "camera": some("intrinsics", problem.camera_ids, out["cameras"]),
            "point": some("points", problem.point_ids, points),
        }
        shutters = {
            f"{name}_covariance": out[f"{name}s"]
            if factor == 1
            else freeze(out[f"{name}s"] * factor)
            for name, part in (("twist", "poses"), ("readout", "intrinsics"))
            if f"{name}s" in out and part in self.of
        }
        null = out["null_points"]
        relative = out["relative"]
        return Covariance(
            **{f"{name}_ids": ids for name, (ids, _) in names.items()},
            **{f"{name}_covariance": values for name, (_, values) in names.items()},
            relative_ids=freeze(np.array(pairs, np.int64).reshape(-1, 2)),
            relative_covariance=relative if factor == 1 else freeze(relative * factor),
            null_point_ids=freeze(np.array(problem.point_ids[null[null < num_points]], np.int64)),
            sigma0=sigma0,
            dof=dof,
            gauge=self.gauge,
            scale=self.scale,
            robust=self.robust,
            notes=notes,
            **shutters,
            _relative=replace(self, of=("poses",)).compute,
        )


def _scaled(problem: Problem, options: SolveOptions, sigma0: float) -> tuple[Problem, SolveOptions]:
    """Return a problem with sigmas multiplied by sigma0; a loss keeps its weights."""
    old = problem.observation_sigma
    sigmas = np.full(problem.num_observations, sigma0) if old is None else sigma0 * old
    if options.loss != "trivial":
        options = options.replace(loss_scale=options.loss_scale / sigma0)
    return problem.replace(observation_sigma=sigmas), options
