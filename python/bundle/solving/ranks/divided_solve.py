"""Solve by several processes: rank 0 sends parts, all ranks solve, rank 0 collects the points."""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.interface.summary import ProcessPart, ProcessRecord, Traffic
from bundle.model.problem import Problem
from bundle.solving.constraints.restrictions import Restrictions
from bundle.solving.prepare import Executor, Prepared
from bundle.solving.ranks.crew import Crew, Job, PartOfOutput, Ranks
from bundle.solving.ranks.partition import divide, factors_of, part_of, reason_to_be_alone, warning

if TYPE_CHECKING:
    from bundle.interface.solve_record import Progress


@dataclass(frozen=True)
class AllProcesses:
    """Executor on all processes, or on this process alone if a solve cannot be divided."""

    crew: Crew
    alone: Executor

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """See :meth:`Executor.run`."""
        layout = prepared.layout
        options, factors = layout.options.asdict(), layout.core_factors()
        shutter = prepared.start.rolling_shutter
        reason = reason_to_be_alone(options, factors)
        if shutter is not None and shutter.is_rolling.any():
            reason = reason or "Rolling shutters are not divided (rolling_shutter)."
        if reason:
            output = self.alone.run(prepared, progress)
            return output | {"alone": warning(reason, self.crew.num_ranks)}
        return solve_divided(self.crew, prepared.start, options, progress, layout.limits, factors)


def solve_divided(
    crew: Crew,
    problem: Problem,
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
    limits: Restrictions | None,
    core_factors: Any,
) -> dict[str, Any]:
    """Solve on all processes; return the output of ``_core.solve``."""
    division = divide(problem, crew.num_ranks)
    points_of = division.parts
    factors = [factors_of(core_factors, points) for points in points_of]
    observed = np.zeros(problem.num_images, np.uint8)
    observed[problem.observation_image] = 1
    fixed = np.asarray(options["fixed_point_ids"], np.int64)
    unknown = np.setdiff1d(fixed, problem.point_ids)
    if unknown.size:
        raise _core.InputError(f"fixed_point_ids: expected ids in the problem, found {unknown[0]}")

    def job(rank: int) -> Job:
        part = part_of(problem, points_of[rank], division.section)
        own = {"fixed_point_ids": np.intersect1d(fixed, part.point_ids).tolist()}
        return Job(part, options | own, limits, factors[rank][0], observed)

    crew.is_solving = True
    for rank in range(1, crew.num_ranks):
        crew.send(job(rank), rank)
    ranks = crew.ranks()
    output, own = work_on(job(0), ranks, heeding(crew, progress))
    points = np.array(problem.points)
    costs = {name: np.zeros(_num_factors(core_factors)) for name in _COSTS}
    parts = []
    for rank in range(crew.num_ranks):
        given = own if rank == 0 else crew.receive(rank)
        points[points_of[rank]] = given.points
        parts.append(given.process)
        for name in _COSTS if factors[rank][1] else ():
            costs[name][factors[rank][1]] = getattr(given, name)
    crew.is_solving = False
    output |= {"points": freeze(points)} | {name: freeze(of) for name, of in costs.items()}
    output["summary"] |= {
        "num_factors": _num_factors(core_factors),
        "num_processes": crew.num_ranks,
        "processes": process_record(parts, ranks),
    }
    return output


def process_record(parts: Iterable[ProcessPart], ranks: Ranks) -> ProcessRecord:
    """Return the record of the ranks' parts and of rank 0's messages."""
    traffic = tuple(
        Traffic(what=what, num_messages=int(n), num_bytes=int(size), seconds=seconds)
        for what, (n, size, seconds) in ranks.traffic.items()
    )
    return ProcessRecord(parts=tuple(parts), traffic=traffic)


def heeding(
    crew: Crew, progress: Callable[[dict[str, Any]], None] | None
) -> Callable[[dict[str, Any]], None]:
    """Return a callback that reports an iteration, then stops the solve after Ctrl-C."""

    def heed(record: dict[str, Any]) -> None:
        if progress is not None:
            progress(record)
        if crew.is_told_to_end:
            raise KeyboardInterrupt

    return heed


_COSTS = ("factor_costs_before", "factor_costs_after")


def work_on(
    job: Job, ranks: Ranks, progress: Callable[[dict[str, Any]], None] | None = None
) -> tuple[dict[str, Any], PartOfOutput]:
    """Solve the part of one process; return the core's output, and the output for rank 0."""
    output = _core.solve_part(
        job.part,
        job.options,
        progress,
        job.restrictions,
        job.factors,
        ranks,
        job.image_is_observed,
    )
    summary = output["summary"]
    names = (
        *("preprocessor_time_in_seconds", "residual_evaluation_time_in_seconds"),
        *("jacobian_evaluation_time_in_seconds", "linear_solver_time_in_seconds"),
        "total_time_in_seconds",
    )
    process = ProcessPart(
        num_points=len(job.part.points),
        num_observations=len(job.part.observation_xy),
        **{name: summary[name] for name in names},
        waiting_time_in_seconds=sum(seconds for _, _, seconds in ranks.traffic.values()),
        peak_memory_in_bytes=_peak_memory(),
    )
    before, after = (output[name] for name in _COSTS)
    return output, PartOfOutput(output["points"], before, after, process)


def _num_factors(core_factors: Any) -> int:
    return 0 if core_factors is None else len(core_factors[1])


def _peak_memory() -> int:
    """Return the largest resident size of this process so far, in bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
