"""Full report of a solve as text, in the order of Ceres' FullReport, and the trace of its steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from bundle.base.tables import columns, facts, notes, render

if TYPE_CHECKING:
    from bundle.base.tables import Columns

Iterations = Mapping[str, NDArray[Any]]

TRACE = (*("iteration", "cost", "change", "gradient", "step", "quality", "radius", "lambda", ""),)


def full_report(
    summary: Any,
    phases: Columns,
    orderings: tuple[str, str],
    iterations: Iterations | None = None,
) -> str:
    """Return all fields of a summary as text.

    Args:
        orderings: sizes of the elimination groups, given and used.
        iterations: arrays of the iterations, for their table; None: no table.
    """
    cost = [
        ("initial", f"{summary.initial_cost:.9e}"),
        ("final", f"{summary.final_cost:.9e}"),
        ("change", f"{summary.initial_cost - summary.final_cost:.9e}"),
        ("fixed", f"{summary.fixed_cost:.9e}"),
        *([("held", f"{summary.held_cost:.9e}")] if summary.held_cost else []),
    ]
    steps = summary.num_successful_steps + summary.num_unsuccessful_steps
    counts = [
        ("minimizer iterations", str(steps)),
        ("successful steps", str(summary.num_successful_steps)),
        ("unsuccessful steps", str(summary.num_unsuccessful_steps)),
        ("rejected share", _rejected_share(summary)),
        ("residual evaluations", str(summary.num_residual_evaluations)),
        ("Jacobian evaluations", str(summary.num_jacobian_evaluations)),
        ("linear solves", str(summary.num_linear_solves)),
    ]
    warnings = notes(summary.warnings)
    return render(
        columns(("size", "original", "reduced"), _problem_size(summary)),
        "",
        columns(("solver", "given", "used"), _solver(summary, orderings), left=3),
        facts(
            [
                ("why this backend", summary.backend_choice or "it was asked for"),
                ("why this solver", summary.linear_solver_choice or "it was asked for"),
            ]
        ),
        "",
        columns(("factor", ""), _factor(summary)),
        "",
        columns(("cost", ""), cost),
        "",
        columns(("count", ""), counts),
        "",
        phases,
        "",
        facts([("termination", f"{summary.termination_type}: {summary.message}")]),
        *([""] if warnings else []),
        *warnings,
        *(() if iterations is None else ("", columns(TRACE, _trace(iterations)))),
    )


def _rejected_share(summary: Any) -> str:
    """Return the rejected share of the steps, without the start, which Ceres counts as a step."""
    rejected = summary.num_unsuccessful_steps
    steps = summary.num_successful_steps + rejected - 1
    return f"{100 * rejected / steps:.1f} %" if steps > 0 else "-"


def _trace(iterations: Iterations) -> list[tuple[str, ...]]:
    """Return a row for each iteration; a step uses the radius that the row before states."""
    names = (
        *("iteration", "cost", "cost_change", "gradient_max_norm", "step_norm"),
        *("relative_decrease", "trust_region_radius", "step_is_successful"),
    )
    rows = zip(*(iterations[name].tolist() for name in names), strict=True)
    return [
        (
            str(number),
            f"{cost:.6e}",
            f"{change:.1e}",
            f"{gradient:.1e}",
            f"{step:.1e}",
            f"{quality:.3f}",
            f"{radius:.1e}",
            f"{1 / radius:.1e}" if radius > 0 else "-",
            "" if accepted else "rejected",
        )
        for number, cost, change, gradient, step, quality, radius, accepted in rows
    ]


def _problem_size(summary: Any) -> list[tuple[str, str, str]]:
    names = ("parameter_blocks", "parameters", "residual_blocks", "residuals")
    return [
        (
            name.replace("_", " "),
            str(getattr(summary, f"num_{name}")),
            str(getattr(summary, f"num_{name}_reduced")),
        )
        for name in names
    ]


def _solver(summary: Any, orderings: tuple[str, str]) -> list[tuple[str, str, str]]:
    strategy = summary.trust_region_strategy_type
    if strategy == "DOGLEG":
        strategy += f" ({summary.dogleg_type})"
    rows = [
        ("backend", summary.backend_given, summary.backend_used),
        ("trust region", strategy, strategy),
        ("linear solver", summary.linear_solver_type_given, summary.linear_solver_type_used),
    ]
    if summary.linear_solver_type_used in ("ITERATIVE_SCHUR", "CGNR"):
        rows.append(
            (
                "preconditioner",
                summary.preconditioner_type_given,
                summary.preconditioner_type_used,
            )
        )
    library = _library(summary)
    rows += [
        ("ordering", *orderings),
        ("Schur structure", summary.schur_structure_given, summary.schur_structure_used),
        ("linear algebra", library, library),
        ("threads", str(summary.num_threads_given), str(summary.num_threads_used)),
    ]
    if summary.instruction_set:
        rows.append(("instruction set", summary.instruction_set, summary.instruction_set))
    return rows


def _factor(summary: Any) -> list[tuple[str, str]]:
    flops, time = summary.factor_flops, summary.symbolic_time_in_seconds
    return [
        ("elimination order", summary.factor_ordering or "-"),
        ("columns", _count(summary.num_factor_columns)),
        ("nonzeros of the information matrix", _count(summary.num_information_nonzeros)),
        ("nonzeros of the reduced system", _count(summary.num_reduced_nonzeros)),
        ("nonzeros of the factor", _count(summary.num_factor_nonzeros)),
        ("flops", "-" if flops is None else f"{flops:.4e}"),
        ("symbolic time [s]", "-" if time is None else f"{time:.6f}"),
    ]


def _count(value: int | None) -> str:
    return "-" if value is None else str(value)


def _library(summary: Any) -> str:
    if summary.linear_solver_type_used.startswith("DENSE"):
        return str(summary.dense_linear_algebra_library_type)
    if summary.linear_solver_type_used.startswith("SPARSE"):
        return str(summary.sparse_linear_algebra_library_type)
    return "EIGEN"
