"""A solver summary as text, in the order of Ceres' FullReport."""

from __future__ import annotations

from collections.abc import Sequence

from bundle.report.text import columns, facts, notes, render
from bundle.report.timing import solver_table
from bundle.result import Summary

__all__ = ["breakdown", "full_report", "sizes"]


def full_report(summary: Summary) -> str:
    """Return the whole summary in lines of text."""
    cost = [
        ("initial", f"{summary.initial_cost:.9e}"),
        ("final", f"{summary.final_cost:.9e}"),
        ("change", f"{summary.initial_cost - summary.final_cost:.9e}"),
        ("fixed", f"{summary.fixed_cost:.9e}"),
    ]
    steps = summary.num_successful_steps + summary.num_unsuccessful_steps
    iterations = [
        ("minimizer iterations", str(steps)),
        ("successful steps", str(summary.num_successful_steps)),
        ("unsuccessful steps", str(summary.num_unsuccessful_steps)),
        ("residual evaluations", str(summary.num_residual_evaluations)),
        ("Jacobian evaluations", str(summary.num_jacobian_evaluations)),
        ("linear solves", str(summary.num_linear_solves)),
    ]
    warnings = ["", *notes(summary.warnings)] if summary.warnings else []
    return render(
        columns(("size", "original", "reduced"), _problem_size(summary)),
        "",
        columns(("solver", "given", "used"), _solver(summary), left=3),
        facts([("why this solver", summary.linear_solver_choice or "it was asked for")]),
        "",
        columns(("cost", ""), cost),
        "",
        columns(("count", ""), iterations),
        "",
        solver_table(summary),
        "",
        facts([("termination", f"{summary.termination_type}: {summary.message}")]),
        *warnings,
    )


def breakdown(summary: Summary) -> str:
    """Return the table of where the time inside the solver went."""
    return render(solver_table(summary))


def sizes(groups: Sequence[int]) -> str:
    """Return the sizes of elimination groups, "22106, 16", or AUTOMATIC: the choice is Ceres'."""
    return ", ".join(map(str, groups)) if groups else "AUTOMATIC"


def _problem_size(summary: Summary) -> list[tuple[str, str, str]]:
    names = ("parameter_blocks", "parameters", "residual_blocks", "residuals")
    return [
        (
            name.replace("_", " "),
            str(getattr(summary, f"num_{name}")),
            str(getattr(summary, f"num_{name}_reduced")),
        )
        for name in names
    ]


def _solver(summary: Summary) -> list[tuple[str, str, str]]:
    strategy = summary.trust_region_strategy_type
    if strategy == "DOGLEG":
        strategy += f" ({summary.dogleg_type})"
    rows = [
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
        (
            "ordering",
            sizes(summary.linear_solver_ordering_given),
            sizes(summary.linear_solver_ordering_used),
        ),
        ("Schur structure", summary.schur_structure_given, summary.schur_structure_used),
        ("linear algebra", library, library),
        ("threads", str(summary.num_threads_given), str(summary.num_threads_used)),
    ]
    return rows


def _library(summary: Summary) -> str:
    if summary.linear_solver_type_used.startswith("DENSE"):
        return summary.dense_linear_algebra_library_type
    if summary.linear_solver_type_used.startswith("SPARSE"):
        return summary.sparse_linear_algebra_library_type
    return "EIGEN"
