"""Summary of a solve, as data and as text.

``bundle.base.tables``, and with it rich, is imported only when something is printed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bundle.base.display import Display, Displayed
from bundle.base.words import change, number, plural, seconds
from bundle.interface.process_record import ProcessRecord

if TYPE_CHECKING:
    from bundle.base.tables import Columns

__all__ = ["Summary", "held_facts", "share", "sizes", "solver_phases", "solver_table"]


@dataclass(frozen=True, kw_only=True, repr=False)
class Summary(Displayed):
    """Ceres' Solver::Summary under Ceres' field names; times in seconds, -1 where not measured.

    Beyond Ceres: ``backend_given`` and ``backend_used``, ``backend_choice`` and
    ``linear_solver_choice`` (why ``auto`` took them; "" when asked for), ``instruction_set`` (what
    the fused backend's kernels run on; "" for Ceres), ``warnings`` (sentences: a fallback, a gauge
    that could not be held, ...) and ``warning_kinds`` (for each of them its name in
    ``bundle.warning_kinds.WARNING_KINDS``, for programs), ``interrupted``, ``origin`` (x, y, z: the
    centre that a scene far from its origin was solved about; None where it was solved as given).
    ``held_cost`` (of observations without a projection at the solution, which keep the residual
    that they had when they lost it, times 4: in no other cost, nor in those of iterations).
    ``num_factors`` beside the observations. ``num_processes`` that mpirun started, and where there
    are several ``processes``, what each of them had and did
    (:class:`bundle.interface.process_record.ProcessRecord`); times are the first one's. Costs are
    1/2 sum rho(||r||^2), r in pixels, and in sigmas for factors.

    What each step factorises (None, or "", where it factorises nothing or the number is unknown;
    blocks count as full, matrices by both triangles and the diagonal, the factor L by its lower
    triangle with the diagonal, all as in ``bundle.inspect``):

    - ``num_information_nonzeros``: of J^T J, J the Jacobian of all that is refined; None only
      without ``check_solution``.
    - ``num_factor_columns``: n of the factorised matrix, which is the reduced camera system S with
      a Schur solver (the points' system where the cameras are eliminated) and J^T J without.
    - ``num_reduced_nonzeros``: of S as its solver holds it, n^2 where that is dense.
    - ``num_factor_nonzeros``, ``factor_flops``: of L; sum of c^2 + 3 c over its columns, c their
      entries below the diagonal.
    - ``factor_ordering``: "natural", "amd", "metis", or "points first, amd".
    - ``symbolic_time_in_seconds``: of finding the pattern, the ordering and L's structure; part of
      the fused backend's preprocessor time; 0 of a ``bundle.Solver``, whose constructor spent it.

    The fused backend's numbers are exact, those of the factor that it stores without the zeros that
    its panels add. Ceres tells nothing of its factor. With it a dense one is exact as well; a
    sparse one is counted after the solve on the pattern that Ceres builds, in CHOLMOD's AMD order
    of its blocks. Ceres asks CHOLMOD for the same kind of order but numbers the blocks its own way,
    so its factor can be some per cent larger or smaller, and the symbolic time is that of our
    count. Empty with Ceres: what ``cameras_first`` leaves for SPARSE_SCHUR (n apart), as its
    pattern takes too long to find, and all where Ceres chose what to eliminate.

    The fused backend linearises and eliminates in one pass. Its Jacobian evaluation therefore
    includes the elimination of the points, its linear solver is that of the reduced camera system
    alone, and its residual evaluation includes the back-substitution.
    """

    initial_cost: float
    final_cost: float
    fixed_cost: float
    termination_type: str
    message: str
    is_solution_usable: bool
    num_successful_steps: int
    num_unsuccessful_steps: int
    num_parameter_blocks: int
    num_parameters: int
    num_residual_blocks: int
    num_residuals: int
    num_parameter_blocks_reduced: int
    num_parameters_reduced: int
    num_residual_blocks_reduced: int
    num_residuals_reduced: int
    trust_region_strategy_type: str
    dogleg_type: str
    linear_solver_type_given: str
    linear_solver_type_used: str
    linear_solver_ordering_given: tuple[int, ...]
    linear_solver_ordering_used: tuple[int, ...]
    schur_structure_given: str
    schur_structure_used: str
    preconditioner_type_given: str
    preconditioner_type_used: str
    dense_linear_algebra_library_type: str
    sparse_linear_algebra_library_type: str
    num_threads_given: int
    num_threads_used: int
    preprocessor_time_in_seconds: float
    residual_evaluation_time_in_seconds: float
    jacobian_evaluation_time_in_seconds: float
    linear_solver_time_in_seconds: float
    minimizer_time_in_seconds: float
    postprocessor_time_in_seconds: float
    total_time_in_seconds: float
    num_residual_evaluations: int
    num_jacobian_evaluations: int
    num_linear_solves: int
    backend_given: str
    backend_used: str
    backend_choice: str
    instruction_set: str
    linear_solver_choice: str
    interrupted: bool
    warnings: tuple[str, ...]
    warning_kinds: tuple[str, ...]
    num_information_nonzeros: int | None = None
    num_factor_columns: int | None = None
    num_reduced_nonzeros: int | None = None
    num_factor_nonzeros: int | None = None
    factor_flops: float | None = None
    factor_ordering: str = ""
    symbolic_time_in_seconds: float | None = None
    origin: tuple[float, float, float] | None = None
    num_factors: int = 0
    held_cost: float = 0.0
    num_processes: int = 1
    processes: ProcessRecord | None = None

    def full_report(self) -> str:
        """Return everything in lines of text, in the order of Ceres' FullReport."""
        return _full_report(self)

    def breakdown(self) -> str:
        """Return the table of where the time inside the solver went, with percentages."""
        from bundle.base.tables import render

        return render(solver_table(self))

    def _display(self) -> Display:
        # Ceres counts the evaluation at the start as a successful step.
        steps = max(self.num_successful_steps + self.num_unsuccessful_steps - 1, 0)
        solver = f"{self.backend_used} {self.linear_solver_type_used}"
        usable = "" if self.is_solution_usable else " (solution not usable)"
        return Display(
            title=f"Summary: {self.termination_type}{usable}: {' '.join(self.message.split())}",
            facts=(
                ("cost", change(self.initial_cost, self.final_cost)),
                *held_facts(self),
                ("steps", f"{steps}, {self.num_unsuccessful_steps} rejected"),
                ("time", f"{seconds(self.total_time_in_seconds)} s"),
                ("solver", f"{solver} on {plural(self.num_threads_used, 'thread')}"),
                *(("warning", warning) for warning in self.warnings),
            ),
        )


# Work of a backend in the times of residual evaluation, Jacobian evaluation and linear solver.
_PHASES = {
    "CERES": ("residual evaluation", "Jacobian evaluation", "linear solver"),
    "FUSED": ("back-substitution, residuals", "Jacobians, elimination", "reduced linear solver"),
    "NORMAL": ("residuals", "Jacobians, normal equations", "linear solver"),
}


def _eliminates(summary: Summary) -> str:
    """Return which phases a solve has: the own backend eliminates nothing of a pose graph."""
    normal = summary.linear_solver_type_used.endswith("NORMAL_CHOLESKY")
    return "NORMAL" if summary.backend_used == "FUSED" and normal else summary.backend_used


def solver_phases(summary: Summary) -> list[tuple[str, float]]:
    """Return (phase, seconds) of a solve, -1 where the solver did not measure.

    Evaluation and linear solver times are parts of the minimizer's time and do not add up to it:
    "other" is what is left of the total, so that the phases do add up.
    """
    residuals, jacobians, linear_solver = _PHASES[_eliminates(summary)]
    phases = [
        ("preprocessor", summary.preprocessor_time_in_seconds),
        (residuals, summary.residual_evaluation_time_in_seconds),
        (jacobians, summary.jacobian_evaluation_time_in_seconds),
        (linear_solver, summary.linear_solver_time_in_seconds),
    ]
    post = summary.postprocessor_time_in_seconds
    total = summary.total_time_in_seconds
    measured = sum(max(time, 0.0) for _, time in phases) + max(post, 0.0)
    other = max(total - measured, 0.0) if total >= 0 else -1.0
    return [*phases, ("other", other), ("postprocessor", post)]


def solver_table(summary: Summary) -> Columns:
    """Return the phases of a solve with their share of it."""
    from bundle.base.tables import columns
    from bundle.base.words import seconds

    total = summary.total_time_in_seconds
    rows = [(name, seconds(time), share(time, total)) for name, time in solver_phases(summary)]
    rows.append(("total", seconds(total), share(total, total)))
    return columns(("time", "seconds", "share"), rows)


def held_facts(summary: Summary) -> tuple[tuple[str, str], ...]:
    """Return the line of the cost that observations without a projection hold, where some do."""
    return (("held cost", number(summary.held_cost)),) if summary.held_cost else ()


def share(time: float, total: float) -> str:
    """Return time as a percentage of total, "-" where one was not measured."""
    return f"{100.0 * time / total:.1f} %" if time >= 0 and total > 0 else "-"


def sizes(groups: Sequence[int]) -> str:
    """Return the sizes of elimination groups, "22106, 16", or AUTOMATIC: the choice is Ceres'."""
    return ", ".join(map(str, groups)) if groups else "AUTOMATIC"


def _full_report(summary: Summary) -> str:
    from bundle.base.tables import columns, facts, notes, render

    cost = [
        ("initial", f"{summary.initial_cost:.9e}"),
        ("final", f"{summary.final_cost:.9e}"),
        ("change", f"{summary.initial_cost - summary.final_cost:.9e}"),
        ("fixed", f"{summary.fixed_cost:.9e}"),
        *([("held", f"{summary.held_cost:.9e}")] if summary.held_cost else []),
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
        columns(("count", ""), iterations),
        "",
        solver_table(summary),
        "",
        facts([("termination", f"{summary.termination_type}: {summary.message}")]),
        *warnings,
    )


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
        (
            "ordering",
            sizes(summary.linear_solver_ordering_given),
            sizes(summary.linear_solver_ordering_used),
        ),
        ("Schur structure", summary.schur_structure_given, summary.schur_structure_used),
        ("linear algebra", library, library),
        ("threads", str(summary.num_threads_given), str(summary.num_threads_used)),
    ]
    if summary.instruction_set:
        rows.append(("instruction set", summary.instruction_set, summary.instruction_set))
    return rows


def _factor(summary: Summary) -> list[tuple[str, str]]:
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


def _library(summary: Summary) -> str:
    if summary.linear_solver_type_used.startswith("DENSE"):
        return summary.dense_linear_algebra_library_type
    if summary.linear_solver_type_used.startswith("SPARSE"):
        return summary.sparse_linear_algebra_library_type
    return "EIGEN"
