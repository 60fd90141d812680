"""Summary of a solve, as data and as text: steps, times, termination, processes.

``bundle.base.tables`` is imported only when something is printed.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import change, number, plural, seconds

if TYPE_CHECKING:
    from bundle.base.tables import Columns


# Methods written for all subclasses: a dataclass would compile its own, and with sixty fields that
# takes as long as a small solve.
@dataclass(frozen=True, kw_only=True, repr=False, init=False, eq=False)
class Summary(Displayed):
    """Ceres' Solver::Summary with Ceres' field names; times in seconds, -1 if not measured.

    Costs are 1/2 sum rho(||r||^2), with r in pixels, or in sigmas for factors. Fields that Ceres
    does not have:

    - ``backend_given`` and ``backend_used``.
    - ``backend_choice`` and ``linear_solver_choice``: reason for the choice of ``auto``; "" if the
      user chose.
    - ``instruction_set``: instruction set of the fused backend's kernels; "" for Ceres.
    - ``warnings``: sentences, for example about a fallback or a gauge that could not be fixed.
    - ``warning_kinds``: for each warning its name in ``bundle.warning_kinds.WARNING_KINDS``, for
      programs.
    - ``interrupted``.
    - ``origin``: x, y, z of the centre to which a scene far from its origin was moved for the
      solve; None if it was not moved.
    - ``held_cost``: cost of the observations that have no projection at the solution. Each keeps
      the residual that it had when it lost its projection, times 4. No other cost, including those
      of iterations, contains it.
    - ``distance_in_sigmas`` and ``largest_camera_step_in_sigmas``: predicted distance to the
      minimum, as the largest change of any function of all parameters and of any function of the
      poses and cameras, in standard deviations of this function (the Newton decrement). None with
      a loss, with an iterative linear solver, or if the solve did not converge.
    - ``num_factors``: number of factors in addition to the observations.
    - ``num_processes``: number of processes that mpirun started.
    - ``processes``: with several processes, their parts of the problem, times and messages
      (:class:`bundle.interface.summary.ProcessRecord`). All other times are those of the
      first process.

    Size of the matrix that each step factorises. Values are None, or "", if no matrix is factorised
    or the number is unknown. All entries of a block are counted. Matrices count with both triangles
    and the diagonal, the factor L with its lower triangle and the diagonal, as in
    ``bundle.inspect``:

    - ``num_information_nonzeros``: nonzeros of J^T J, where J is the Jacobian of all refined
      variables; None only without ``check_solution``.
    - ``num_factor_columns``: size n of the factorised matrix. With a Schur solver it is the reduced
      camera system S (or the points' system if cameras are eliminated), otherwise J^T J.
    - ``num_reduced_nonzeros``: nonzeros of S as stored by its solver; n^2 if it is dense.
    - ``num_factor_nonzeros``: nonzeros of L.
    - ``factor_flops``: sum of c^2 + 3 c over the columns of L, where c is the number of entries
      below the diagonal.
    - ``factor_ordering``: "natural", "amd", "metis", "minimum_fill", or "points first, amd".
    - ``least_factor_flops`` and ``least_flops_ordering``: the least flops of the orders that were
      compared with the one used, and its name; None and "" if none was compared, which is usual
      (``bundle.interface.ordering_alarm``).
    - ``symbolic_time_in_seconds``: time to find the pattern, the ordering and L's structure. It is
      part of the fused backend's preprocessor time. It is 0 for a ``bundle.Solver``, which spends
      this time in its constructor.

    The fused backend's numbers are exact: they describe the stored factor without the zeros that
    its panels add. Ceres does not report its factor. For Ceres, the numbers of a dense factor are
    exact. A sparse factor is counted after the solve, on the pattern that Ceres builds, in
    CHOLMOD's AMD order of its blocks. Ceres requests the same kind of order but numbers the blocks
    differently, so its factor can be some per cent larger or smaller. The symbolic time is then the
    time of this count. With Ceres, two cases have no numbers. For SPARSE_SCHUR with
    ``cameras_first``, only n is given, because its pattern takes too long to find. If Ceres chose
    the eliminated variables, all numbers are empty.

    The fused backend linearises and eliminates in one pass. Its Jacobian evaluation time therefore
    includes the elimination of the points. Its linear solver time covers only the reduced camera
    system, and its residual evaluation time includes the back-substitution.
    """

    # Iterations of the result, for full_report(). A slot is not a field: vars() has fields only.
    __slots__ = ("_iterations",)

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
    least_factor_flops: float | None = None
    least_flops_ordering: str = ""
    symbolic_time_in_seconds: float | None = None
    origin: tuple[float, float, float] | None = None
    num_factors: int = 0
    held_cost: float = 0.0
    distance_in_sigmas: float | None = None
    largest_camera_step_in_sigmas: float | None = None
    num_processes: int = 1
    processes: ProcessRecord | None = None

    def __init__(self, **fields: Any) -> None:
        kind: Any = type(self)  # mypy does not take the class of an object with a hash for hashable
        defaults = _defaults(kind)
        values = defaults | fields  # in the order of the fields
        if len(values) > len(defaults) or dataclasses.MISSING in values.values():
            missing = [name for name, value in values.items() if value is dataclasses.MISSING]
            unknown = [name for name in fields if name not in defaults]
            raise TypeError(
                f"{kind.__name__}: expected its fields by name, missing: "
                f"{', '.join(missing) or '-'}, unknown: {', '.join(unknown) or '-'}"
            )
        vars(self).update(values)

    def __eq__(self, other: object) -> bool:
        return vars(self) == vars(other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(tuple(vars(self).values()))

    def __setstate__(self, state: Any) -> None:
        """Restore a pickle: the fields, and the iterations if it has them."""
        fields, slots = state if isinstance(state, tuple) else (state, {})
        vars(self).update(fields)
        for name, value in (slots or {}).items():
            object.__setattr__(self, name, value)

    def full_report(self) -> str:
        """Return all fields as lines of text, in the order of Ceres' FullReport.

        The summary of a result ends with the table of its iterations, with the damping lambda = 1 /
        radius of each step.
        """
        from bundle.interface.full_report import full_report  # when it is read

        groups = self.linear_solver_ordering_given, self.linear_solver_ordering_used
        orderings = sizes(groups[0]), sizes(groups[1])
        return full_report(self, solver_table(self), orderings, getattr(self, "_iterations", None))

    def breakdown(self) -> str:
        """Return a table of the solver's phases with times and percentages."""
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


@functools.cache
def _defaults(kind: type[Any]) -> dict[str, Any]:
    return {field.name: field.default for field in dataclasses.fields(kind)}


# Work that a backend's residual evaluation, Jacobian evaluation and linear solver times include.
_PHASES = {
    "CERES": ("residual evaluation", "Jacobian evaluation", "linear solver"),
    "FUSED": ("back-substitution, residuals", "Jacobians, elimination", "reduced linear solver"),
    "NORMAL": ("residuals", "Jacobians, normal equations", "linear solver"),
}


def _eliminates(summary: Summary) -> str:
    """Return the key of the solve's phases; for pose graphs, FUSED does not eliminate variables."""
    normal = summary.linear_solver_type_used.endswith("NORMAL_CHOLESKY")
    return "NORMAL" if summary.backend_used == "FUSED" and normal else summary.backend_used


def solver_phases(summary: Summary) -> list[tuple[str, float]]:
    """Return (phase, seconds) of a solve; -1 for a time that the solver did not measure.

    Evaluation and linear solver times do not add up to the minimizer's time. The phase "other" is
    the remainder of the total time.
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
    """Return a table of a solve's phases with their percentages of the total time."""
    from bundle.base.tables import columns
    from bundle.base.words import seconds

    total = summary.total_time_in_seconds
    rows = [(name, seconds(time), share(time, total)) for name, time in solver_phases(summary)]
    rows.append(("total", seconds(total), share(total, total)))
    return columns(("time", "seconds", "share"), rows)


def held_facts(summary: Summary) -> tuple[tuple[str, str], ...]:
    """Return the line of ``held_cost``, or () if every observation has a projection."""
    return (("held cost", number(summary.held_cost)),) if summary.held_cost else ()


def share(time: float, total: float) -> str:
    """Return time as a percentage of total; "-" if one of them was not measured."""
    return f"{100.0 * time / total:.1f} %" if time >= 0 and total > 0 else "-"


def sizes(groups: Sequence[int]) -> str:
    """Return the sizes of elimination groups, "22106, 16", or AUTOMATIC if Ceres chose them."""
    return ", ".join(map(str, groups)) if groups else "AUTOMATIC"


# First words of Ceres' messages (trust_region_minimizer.cc, solver.cc), identical in versions 1.14
# to 2.2. "{limit}" is the tolerance at the end of the message.
_REASONS = {
    "Function tolerance reached. No non-constant": ": all parameters are constant",
    "Function tolerance reached": " (relative cost change below {limit})",
    "Gradient tolerance reached": " (largest entry of the gradient below {limit})",
    "Parameter tolerance reached": " (relative parameter change below {limit})",
    "Minimum trust region radius reached": (
        ": no step lowers the cost (minimum trust region radius reached)"
    ),
    "Maximum number of iterations reached": ": iteration limit reached. The best state is kept",
    "Maximum solver time reached": ": time limit reached. The best state is kept",
    "Number of consecutive invalid steps": (
        ": consecutive steps had no finite cost, or their linear system was not solved"
    ),
    "Linear solver failed": ": fatal error of the linear solver",
    "Initial residual and Jacobian evaluation failed": (
        ": cost or Jacobian not finite at the start"
    ),
    "Residual and Jacobian evaluation failed": ": cost or Jacobian no longer finite",
}
_VERDICTS = {
    "CONVERGENCE": "Converged in",
    "NO_CONVERGENCE": "Not converged after",
    "FAILURE": "Failed after",
}


def short_outcome(summary: Summary, done: str) -> str:
    """Return the outcome as "Not converged after 5 steps (time limit reached)".

    `done` is the work done, such as "5 steps". A tolerance that was reached is not named.
    """
    if summary.interrupted:
        return f"Interrupted after {done}"
    verdict = f"{_verdict(summary)} {done}"
    for beginning, reason in _REASONS.items():
        if summary.message.startswith(beginning):
            why = reason.partition(": ")[2].removesuffix(". The best state is kept")
            return f"{verdict} ({why})" if why else verdict
    return verdict


def sentence(summary: Summary, num_steps: int, num_rejected: int = 0) -> str:
    """Return a sentence on the termination; ``num_rejected`` steps were not accepted."""
    steps = plural(num_steps, "step")
    if num_rejected:
        steps += f", {num_rejected} rejected"
    if summary.interrupted:
        return f"Interrupted after {steps}. The best state is kept."
    verdict = f"{_verdict(summary)} {steps}"
    for beginning, reason in _REASONS.items():
        if summary.message.startswith(beginning):
            return f"{verdict}{reason.format(limit=_limit(summary.message))}."
    return f"{verdict}: {' '.join(summary.message.split()) or summary.termination_type}"


def _verdict(summary: Summary) -> str:
    """Return the first words of the outcome; an unusable result never counts as converged."""
    if summary.termination_type == "CONVERGENCE" and not summary.is_solution_usable:
        return "Ended after"
    return _VERDICTS.get(summary.termination_type, "Ended after")


def _limit(message: str) -> str:
    """Return the tolerance in a message such as "... 3.4e-07 <= 1.0e-06": "1e-6"."""
    found = re.search(r"<= ([-+.\de]+)", message)
    if found is None:
        return "its tolerance"
    text = f"{float(found[1].rstrip('.')):g}"
    return re.sub(r"e([-+])0?", lambda sign: "e-" if sign[1] == "-" else "e", text)


@dataclass(frozen=True, kw_only=True)
class ProcessPart:
    """One process: its part of the problem, and the times of its phases in seconds.

    The phases are those of :class:`bundle.Summary`. Each includes the time in which the process
    waited for other processes; ``waiting_time_in_seconds`` is the total of these waiting times.
    """

    num_points: int
    num_observations: int
    preprocessor_time_in_seconds: float
    residual_evaluation_time_in_seconds: float
    jacobian_evaluation_time_in_seconds: float
    linear_solver_time_in_seconds: float
    total_time_in_seconds: float
    waiting_time_in_seconds: float
    peak_memory_in_bytes: int


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """Messages of one kind between the processes of a solve."""

    # "normal equations" (S, its right-hand side and block diagonal, to the first process),
    # "gradient", "step", "scalars", or "setup"
    what: str
    num_messages: int  # number of calls in each process
    num_bytes: int  # size of the arrays that were summed or sent, counted once per call
    seconds: float  # time that the first process spent in these calls, including waiting for others


@dataclass(frozen=True, kw_only=True)
class ProcessRecord:
    """A solve by several processes."""

    parts: tuple[ProcessPart, ...]  # one entry per process, in order of rank
    traffic: tuple[Traffic, ...]  # one entry per kind of message, in the order of first appearance

    @staticmethod
    def of_dict(given: Mapping[str, Any]) -> ProcessRecord:
        """Return the record from its ``dataclasses.asdict`` or JSON form."""
        return ProcessRecord(
            parts=tuple(ProcessPart(**part) for part in given["parts"]),
            traffic=tuple(Traffic(**kind) for kind in given["traffic"]),
        )

    @property
    def balance(self) -> float:
        """Largest number of observations of a process, divided by the mean; 1: balanced."""
        counts = [part.num_observations for part in self.parts]
        return max(counts) * len(counts) / max(sum(counts), 1)

    @property
    def num_bytes(self) -> int:
        """Total number of bytes of all messages."""
        return sum(kind.num_bytes for kind in self.traffic)
