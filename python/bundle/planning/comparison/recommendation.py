"""Minima at which methods ended, and the recommended method with its command line."""

from __future__ import annotations

import dataclasses
import math
import shlex
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.words import duration, plural
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import COMPARED, CompareOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.losses import evaluate_loss
from bundle.model.problem import Problem
from bundle.model.residuals import residuals
from bundle.planning.comparison.comparison_result import Comparison, Recommendation
from bundle.planning.comparison.measured_run import ITERATIVE, Method, Prediction, Run
from bundle.planning.comparison.process import WorkerEnd, restore_solution
from bundle.planning.inspection.inspection_result import Inspection

# Minima at which the methods of a comparison ended.
#
# Solutions within one sigma of that of the lowest cost are at the same minimum: no measurement
# could distinguish them. Single points at other positions are ignored. A solution farther away is
# at another minimum, or its method stopped too early. To distinguish these cases, one method
# continues from each solution at tight tolerances. Solutions whose continuations meet are at one
# minimum. Costs alone cannot distinguish them: an early stop and a poor minimum can have the same
# gap.
#
# The distance between two solutions in sigmas needs no covariance. Let x_a and x_b be two
# solutions, r their residuals in sigmas of the observations, J the Jacobian, and W = diag(rho') the
# weights of the loss at the solution of the lowest cost. The covariance is C = sigma0^2 (J^T W
# J)^-1 with sigma0^2 = r^T W r / (residuals - parameters). The distance
#
#     d^2 = (x_a - x_b)^T C^-1 (x_a - x_b) = ||W^1/2 J (x_a - x_b)||^2 / sigma0^2
#         = ||W^1/2 (r_a - r_b)||^2 / sigma0^2        to first order
#
# needs no Jacobian, and does not depend on the gauge: J maps free directions to 0. By Cauchy and
# Schwarz it bounds every parameter and every linear combination of parameters v,
#
#     |v^T (x_a - x_b)| <= d sqrt(v^T C v),
#
# with equality for one v (Scheffe's bound). At a minimum x_b the cost rises by d^2 sigma0^2 / 2, so
# a relative gap g of the cost is a distance of about sqrt(g (residuals - parameters)): for a
# million observations, a gap of 1e-6 is more than one sigma.
#
# A point with an outlier or without parallax often has several minima of its own, which the cameras
# do not notice. d^2 is a sum over observations, hence over points. Points that alone contribute
# more than one sigma are therefore counted and left out, if they are at most 0.2 % of all: the rest
# of the sum bounds all other parameters, for a covariance without the observations of these points.


SAME = 1.0  # distance in sigmas up to which two solutions are at the same minimum

Refine = Callable[[Run, Path], WorkerEnd]


def find_minima(
    problem: Problem,
    options: SolveOptions,
    runs: Sequence[Run],
    solutions: Mapping[Method, Path],
    refine: Refine | None,
) -> list[Run]:
    """Return the runs with their distances and minima.

    ``runs``: one run per method. ``solutions``: stored solutions; runs without one keep an unknown
    minimum. ``refine``: continues the solution of a run at tight tolerances and stores the result
    at a path; None to leave distant solutions at an unknown minimum.
    """
    usable = [run for run in runs if run.is_usable and solutions[run.method].exists()]
    if not usable:
        return list(runs)
    best = min(usable, key=lambda run: run.final_cost)
    distance = SolutionDistance(problem, options, solutions[best.method], _redundancy(best))
    apart = {
        run.method: distance.between(solutions[run.method], solutions[best.method])
        for run in usable
    }
    far = [run for run in usable if apart[run.method].sigmas > SAME]
    numbers = {run.method: 0 for run in usable if run not in far}
    if far and refine is not None:
        found = _minima([best, *far], solutions, distance, refine)
        if best.method in found:
            numbers = dict.fromkeys(numbers, found[best.method]) | found
    return [
        dataclasses.replace(
            run,
            distance_in_sigmas=apart[run.method].sigmas,
            num_points_elsewhere=apart[run.method].num_points,
            minimum=numbers.get(run.method, -1),
        )
        if run.method in apart
        else run
        for run in runs
    ]


def _redundancy(run: Run) -> int:
    """Return the number of residuals minus the number of parameters."""
    assert run.measurement is not None  # the caller chose a usable run
    summary = run.measurement.summary
    return summary.num_residuals_reduced - summary.num_parameters_reduced


def _minima(
    runs: Sequence[Run],
    solutions: Mapping[Method, Path],
    distance: SolutionDistance,
    refine: Refine,
) -> dict[Method, int]:
    """Continue the runs; return the number of the minimum of each that converged."""
    ends: list[tuple[float, Method, Path]] = []
    for run in runs:
        target = solutions[run.method].with_suffix(".end.npz")
        summary = (refine(run, target).measurement or {}).get("summary", {})
        if summary.get("termination_type") == "CONVERGENCE" and target.exists():
            ends.append((summary["final_cost"], run.method, target))
    centres: list[Path] = []
    numbers: dict[Method, int] = {}
    for _, method, path in sorted(ends, key=lambda end: end[0]):
        near = (
            k for k, centre in enumerate(centres) if distance.between(path, centre).sigmas <= SAME
        )
        number = next(near, len(centres))
        if number == len(centres):
            centres.append(path)
        numbers[method] = number
    return numbers


MOST_POINTS = 0.002  # largest share of points that are left out

LEAST_SIGMA0 = 1e-3
"""Least sigma0. Data without noise would make rounding errors many sigmas."""


class Distance(NamedTuple):
    """Distance of two solutions."""

    sigmas: float  # distance without the points that are counted
    num_points: int  # number of points that are at other positions


class SolutionDistance:
    """Distances between stored solutions of one problem.

    Args:
        problem: the problem; its values are not used.
        options: options of the solves.
        best: stored solution of the lowest cost.
        redundancy: number of residuals minus number of parameters.
    """

    def __init__(
        self, problem: Problem, options: SolveOptions, best: Path, redundancy: int
    ) -> None:
        self._problem, self._options = problem, options
        residual = self._residual(best)
        squared = np.where(np.isfinite(residual), residual, 0.0) ** 2
        lengths = squared.sum(axis=1)
        rho = evaluate_loss(options.loss, options.loss_scale, lengths)
        self._weight = rho[:, 1]
        variance = float(self._weight @ lengths) / max(redundancy, 1)
        self._sigma0 = max(math.sqrt(variance), LEAST_SIGMA0)

    def between(self, one: Path, other: Path) -> Distance:
        """Return the distance. Observations without a projection in one solution are ignored."""
        apart = self._residual(one) - self._residual(other)
        squared = (np.where(np.isfinite(apart), apart, 0.0) ** 2).sum(axis=1)
        problem = self._problem
        weighted = self._weight * squared / self._sigma0**2
        of_points = np.bincount(problem.observation_point, weighted, problem.num_points)
        elsewhere = of_points > 1
        if elsewhere.sum() > MOST_POINTS * problem.num_points:
            elsewhere[:] = False
        return Distance(math.sqrt(float(of_points[~elsewhere].sum())), int(elsewhere.sum()))

    def _residual(self, path: Path) -> NDArray[np.float64]:
        """Return (num_observations, 2) residuals in sigmas; NaN where they are ignored."""
        problem = restore_solution(self._problem, path)
        found = residuals(problem, self._options.cheirality)
        xy = np.where(found.counted[:, None], found.xy, np.nan)
        sigma = problem.observation_sigma
        return xy if sigma is None else xy / sigma[:, None]


def reason_on_one(comparison: Comparison, method: Method, tolerance: float) -> str:
    """Return text: "SPARSE_SCHUR: S is 14 % full, AMD needs 2.1e9 flops per step; DENSE_SCHUR ...".

    ``tolerance``: relative distance to the best cost within which solutions are equally good.
    """
    runs = comparison.runs_of(0)
    (winner,) = (run for run in runs if run.method == method)
    structure = _structure(winner, runs)
    begin = f"{method.name}: {structure}; " if structure else f"{method.name}: "
    total = winner.total_time_in_seconds
    words = [f"the solve takes {duration(total)}"]
    rivals = _rivals(winner, runs)
    slower = [rival for rival in rivals if rival.is_usable]
    if slower:
        words.append(", ".join(_behind(comparison, winner, rival, tolerance) for rival in slower))
    words += [
        f"{_told_apart(method, rival.method)} has no result ({rival.outcome.replace('_', ' ')})"
        for rival in rivals
        if not rival.is_usable
    ]
    return f"{begin}{'; '.join(words)}."


def reason_on_many(method: Method, ratios: Sequence[Mapping[Method, float]]) -> str:
    """Return the number of problems on which the method is the fastest, and its largest ratio.

    ``ratios``: for each problem, times of the methods that solved it relative to the fastest.
    """
    own = [row[method] for row in ratios if method in row]
    fastest = sum(ratio == 1 for ratio in own)
    words = f"{method.name}: the fastest on {fastest} of {plural(len(ratios), 'problem')}"
    if max(own) > 1:
        words += f", at worst {_times(max(own))} the fastest"
    if len(own) < len(ratios):
        words += f"; it reached the best cost on {len(own)} of them"
    return words + "."


def _structure(winner: Run, runs: Sequence[Run]) -> str:
    """Return the known properties of the matrix."""
    known = winner.prediction
    if known is None:
        return _shares(winner)
    full = _fullness(known)
    solver = winner.method.linear_solver_type
    if solver in ITERATIVE:
        factor = _least_flops(runs)
        words = [full] if full else []
        if factor:
            words.append(f"a factorisation would need {factor:.1e} flops per step")
        words.append(_iterations(winner))
        return ", ".join(words)
    if not math.isfinite(known.flops):
        return full or _shares(winner)
    maker = known.ordering.upper() if solver == "sparse_schur" else "its dense factorisation"
    flops = f"{maker or 'its factorisation'} needs {known.flops:.1e} flops per step"
    return f"{full}, {flops}" if full else flops


def _fullness(known: Prediction) -> str:
    cells = float(known.num_unknowns) ** 2
    if not 0 < known.nnz_reduced <= cells:
        return ""
    share = 100 * known.nnz_reduced / cells
    full = f"{share:.0f}" if share >= 9.5 else f"{share:.1g}"
    return f"S ({known.num_unknowns} columns) is {full} % full"


def _least_flops(runs: Sequence[Run]) -> float:
    known = [run.prediction.flops for run in runs if run.prediction and run.prediction.nnz_factor]
    return min((flops for flops in known if math.isfinite(flops)), default=0.0)


def _iterations(winner: Run) -> str:
    measurement = winner.measurement
    if measurement is None:
        return ""
    inner = np.asarray(measurement.iterations["linear_solver_iterations"], float)[1:]
    mean = inner.mean() if inner.size else 0.0
    return f"conjugate gradients take {mean:.0f} iterations per step"


def _shares(winner: Run) -> str:
    """Return the linear solver's share of the time, for a method without a prediction."""
    measurement = winner.measurement
    total = winner.total_time_in_seconds
    if measurement is None or not total > 0:
        return ""
    share = measurement.breakdown["linear solver"] / total
    return f"the linear solver takes {100 * share:.0f} % of the time"


def _rivals(winner: Run, runs: Sequence[Run]) -> list[Run]:
    """Return the best run of each other linear solver and of each other backend."""
    own = winner.method
    groups: dict[str, list[Run]] = {}
    for run in runs:
        method = run.method
        if method.backend != own.backend:
            groups.setdefault(method.backend, []).append(run)
        elif method.linear_solver_type != own.linear_solver_type:
            groups.setdefault(method.linear_solver_type, []).append(run)
        elif method.preconditioner_type != own.preconditioner_type:
            groups.setdefault("preconditioner", []).append(run)
        elif method.num_threads != own.num_threads:
            groups.setdefault(method.threads, []).append(run)
    return [min(group, key=_speed) for group in groups.values()]


def _speed(run: Run) -> tuple[bool, float]:
    return not run.is_usable, run.total_time_in_seconds if run.is_usable else 0.0


def _behind(comparison: Comparison, winner: Run, rival: Run, tolerance: float) -> str:
    """Return text about a rival: its additional time and its higher final cost."""
    ratio = rival.total_time_in_seconds / winner.total_time_in_seconds
    name = _told_apart(winner.method, rival.method)
    verb = "take" if name.endswith("threads") else "takes"
    words = f"{name} {verb} {_times(ratio)} as long"
    gap = comparison.gap(rival)
    if gap > tolerance:
        words += f" and ends {gap:.1e} above the best cost"
    return words


def _told_apart(winner: Method, rival: Method) -> str:
    """Return the part of a method's name that differs from the recommended method."""
    if rival.backend != winner.backend:
        return rival.name
    if rival.linear_solver_type != winner.linear_solver_type:
        return rival.linear_solver_type.upper()
    if rival.preconditioner_type != winner.preconditioner_type:
        return rival.preconditioner_type.upper()
    return rival.threads


def _times(ratio: float) -> str:
    return f"{ratio:.2f} times" if ratio < 9.95 else f"{ratio:.0f} times"


COST_TOLERANCE = 1e-3
"""Relative distance to the best final cost within which solutions count as equally good."""

NEAR_ENOUGH = 1.15
"""Factor of the shortest total time within which a predicted method counts as right."""


def recommend(
    comparison: Comparison, foreseen: Sequence[Method | None] = ()
) -> Recommendation | None:
    """Return the fastest of the methods that reached the best cost.

    With several problems, it is the method that reached the best cost most often. Ties are resolved
    by the smallest geometric mean of times relative to the fastest.

    ``comparison``: comparison without a recommendation.

    Returns:
        None if no run has a usable solution, or if no problem has one minimum.
    """
    numbers = range(len(comparison.problems))
    ratios = [
        {} if len(comparison.minima(index)) > 1 else _ratios(comparison, index) for index in numbers
    ]
    ranked = sorted(
        (method for method in comparison.methods if any(method in row for row in ratios)),
        key=lambda method: _rank(method, ratios),
    )
    if not ranked:
        return None
    best = ranked[0]
    one = len(comparison.problems) == 1
    source = comparison.problems[0].name if one and comparison.problems[0].is_file else "INPUT"
    return Recommendation(
        method=best,
        reason=reason_on_one(comparison, best, COST_TOLERANCE)
        if one
        else reason_on_many(best, ratios),
        command=command_line(best.options(comparison.options), source),
        foreseen=tuple(foreseen),
        verdict=_verdict(ratios, foreseen),
    )


def _ratios(comparison: Comparison, problem: int) -> dict[Method, float]:
    """Return total times relative to the least, of the runs that reached the best cost."""
    good = [run for run in comparison.runs_of(problem) if reached_best(comparison, run)]
    least = min((run.total_time_in_seconds for run in good), default=math.nan)
    return {run.method: run.total_time_in_seconds / least for run in good}


def reached_best(comparison: Comparison, run: Run) -> bool:
    """Return True for a usable run near the lowest cost, and at its minimum as far as known."""
    if not run.is_usable or comparison.gap(run) > COST_TOLERANCE:
        return False
    usable = (other for other in comparison.runs_of(run.problem) if other.is_usable)
    return run.minimum == min(usable, key=lambda other: other.final_cost).minimum


def _rank(method: Method, ratios: Sequence[dict[Method, float]]) -> tuple[int, float]:
    """Return the sort key of a method; the best sorts first."""
    own = [row[method] for row in ratios if method in row]
    return -len(own), statistics.geometric_mean(own)


def _verdict(ratios: Sequence[dict[Method, float]], foreseen: Sequence[Method | None]) -> str:
    """Compare the predicted method with the measured ones, in one sentence."""
    judged = [
        (method, row) for row, method in zip(ratios, foreseen, strict=False) if row and method
    ]
    if not judged:
        return ""
    right = [row.get(method, math.inf) <= NEAR_ENOUGH for method, row in judged]
    within = f"within {round(100 * (NEAR_ENOUGH - 1))} % of the fastest"
    if len(judged) > 1:
        share = f"{sum(right)} of {len(judged)} problems"
        return f"`bundle inspect` predicted a method {within} on {share}."
    method, row = judged[0]
    name = f"`bundle inspect` predicted {method.name} on {method.threads}"
    if method not in row:
        return f"{name}. This was wrong: it did not reach the best cost."
    if row[method] == 1:
        return f"{name}. This was right."
    verdict = "right" if right[0] else "wrong"
    return f"{name}. This was {verdict}: it takes {row[method]:.2f} times as long as the fastest."


def command_line(
    options: SolveOptions | PoseGraphOptions, source: str = "INPUT", output: str = "OUTPUT"
) -> str:
    """Return the `bundle refine` command with these options; default values are left out."""
    words = ["bundle", "refine", source, "-o", output]
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if value != field.default:
            words += _flag(field, value)
    return shlex.join(words)


def comparison_command(comparison: Comparison, *, perturb: float) -> str:
    """Return the `bundle compare` command of a comparison, with another perturbation."""
    words = ["bundle", "compare"]
    words += [problem.name if problem.is_file else "INPUT" for problem in comparison.problems]
    words += ["--perturb", f"{perturb:g}"]
    defaults = CompareOptions()
    for name, listed in COMPARED.items():
        of = [m for m in comparison.methods if m.is_iterative or name != "preconditioner_type"]
        values = tuple(dict.fromkeys(getattr(method, name) for method in of))
        usual = (_core.hardware_threads(),) if listed == "threads" else getattr(defaults, listed)
        if values and values != usual:
            words += [f"--{listed.replace('_', '-')}", ",".join(map(str, values)).replace("_", "-")]
    for field in dataclasses.fields(comparison.options):
        value = getattr(comparison.options, field.name)
        if value != field.default:
            words += _flag(field, value)
    return shlex.join(words)


def recommended_command(
    inspection: Inspection, options: SolveOptions, source: str = "INPUT"
) -> str:
    """Return the `bundle refine` command that an inspection recommends; "" without one."""
    if inspection.recommended < 0:
        return ""
    best = inspection.methods[inspection.recommended]
    options = options.replace(
        linear_solver_type=best.linear_solver_type.lower(),
        preconditioner_type=best.preconditioner.lower() or "auto",
        backend="ceres" if best.backend == "CERES" else "auto",
    )
    return command_line(options, source)


def _flag(field: dataclasses.Field[Any], value: Any) -> list[str]:
    flag = field.metadata["flag"]
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag.lstrip('-')}"]
    text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
    named = field.metadata["choices"] is not None or field.name == "refine"
    return [flag, text.replace("_", "-") if named else text]
