"""Executors: the core's solver in this process or in all processes that mpirun started."""

from __future__ import annotations

from typing import Any

import bundle._core as _core
from bundle.base.arguments import check_function
from bundle.interface.solve_record import Progress
from bundle.solving.prepare import Executor, Prepared
from bundle.solving.ranks.launch import current
from bundle.solving.result import Result

__all__ = ["ThisProcess", "solve_prepared"]


class ThisProcess:
    """The core's solver in this process."""

    @staticmethod
    def run(prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """See :meth:`Executor.run`."""
        options, _, limits = layout = prepared.layout
        return _core.solve(
            prepared.start, options.asdict(), progress, limits, layout.core_factors()
        )


def solve_prepared(prepared: Prepared, progress: Progress | None) -> Result:
    """Run the solver, on all processes if there are several, and return the result for the start.

    Raises:
        InputError: for the reasons of :func:`bundle.solve`.
    """
    check_function("progress", progress)
    executor: Executor = ThisProcess()
    crew = current()
    if crew is not None:
        from bundle.solving.ranks.divided_solve import AllProcesses  # imported under mpirun only

        executor = AllProcesses(crew, executor)
    return prepared.result(executor.run(prepared, progress))
