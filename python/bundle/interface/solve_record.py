"""Record of a solve, common to reconstructions and graphs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Displayed
from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary, sentence
from bundle.interface.tabular import Tabular

Progress = Callable[[dict[str, Any]], None]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SolveRecord(Displayed, Tabular):
    """Common base of the results of reconstructions and of graphs."""

    options: SolveOptions  # every option as used
    summary: Summary  # summary of the solver
    iterations: dict[str, NDArray[np.generic]]  # an array per field of IterationSummary
    build_time_in_seconds: float  # time outside the solver
    solve_time_in_seconds: float  # time inside the solver

    def __post_init__(self) -> None:
        # full_report() of the summary has the table of the iterations
        object.__setattr__(self.summary, "_iterations", self.iterations)

    @property
    def num_steps(self) -> int:
        """Number of steps, including rejected steps."""
        return len(self.iterations["iteration"]) - 1

    @property
    def outcome(self) -> str:
        """Outcome of the solve in one sentence."""
        # Entry 0 is the evaluation at the start, not a step.
        accepted = np.asarray(self.iterations["step_is_successful"], bool)[1:]
        return sentence(self.summary, len(accepted), int((~accepted).sum()))


def with_warnings(fields: Mapping[str, Any], sentences: Mapping[str, str]) -> dict[str, Any]:
    """Return the fields of a summary with warnings added: sentences by kind; "" adds nothing."""
    said = {kind: sentence for kind, sentence in sentences.items() if sentence}
    return {
        **fields,
        "warnings": (*fields["warnings"], *said.values()),
        "warning_kinds": (*fields["warning_kinds"], *said),
    }


def record_fields(output: Mapping[str, Any], summary: Summary | None = None) -> dict[str, Any]:
    """Return the fields of a record, without options; ``summary`` replaces that of the output."""
    return {
        "summary": summary or Summary(**output["summary"]),
        "iterations": output["iterations"],
        "build_time_in_seconds": output["build_time_in_seconds"],
        "solve_time_in_seconds": output["solve_time_in_seconds"],
    }
