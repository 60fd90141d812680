"""Checkpoint: the file from which a killed run continues; adjustment in segments between files.

It is a NumPy archive (.npz). It holds the start values of the next solve, the masks of the
observations and points that passed the filters, and the record of the run so far. It also holds a
fingerprint of the run: a digest of the input, and every option that affects the result (not the
number of threads). The file is replaced atomically (``bundle.io.atomic.atomic_write``: write a
temporary file in the same folder, flush it, rename it). A kill at any instant leaves a valid
checkpoint.

A checkpoint takes 24 bytes per point, 56 per image (and per frame of a rig), 48 more per image with
a rolling shutter, and one bit per observation. It costs the time to write this size to the disk.
"""

from __future__ import annotations

import dataclasses
import json
import re
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, first_line, shown
from bundle.interface.options import LARGEST_RADIUS, SolveOptions
from bundle.interface.solve_record import Progress
from bundle.interface.summary import ProcessRecord, Summary
from bundle.io.atomic import atomic_write as atomic
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem import Problem
from bundle.solving.prepare import Prepared
from bundle.solving.result import Result
from bundle.solving.rounds.input_digest import fingerprint_of_options, fingerprint_of_run
from bundle.solving.rounds.plan import RunPlan, State

SCHEMA = "bundle checkpoint 3"

Made = TypeVar("Made")


class Checkpoint:
    """The checkpoint of one run.

    Args:
        path: path of the file, which must not be another kind of file.
        fingerprint: fingerprint of the run.
        interval: iterations from one checkpoint to the next.
    """

    def __init__(self, path: Path, fingerprint: Mapping[str, Any], interval: int) -> None:
        atomic.check_file(path)
        if path.exists() and path.stat().st_size > 0:
            _open(path)
        self._path, self._fingerprint, self.interval = path, fingerprint, interval

    @staticmethod
    def of(path: Path, prepared: Prepared, plan: RunPlan) -> Checkpoint:
        """Return the checkpoint of a run of a prepared solve."""
        return Checkpoint(path, fingerprint_of_run(prepared, plan), plan.checkpoint_interval)

    def write(self, state: State) -> None:
        """Replace the file."""
        done = state.so_far if state.end is None else state.end
        meta = {
            "schema": SCHEMA,
            "fingerprint": dict(self._fingerprint),
            **state.record(),
            "so_far": None if done is None else _record(done),
        }
        kept: dict[str, Any] = {**estimates(state.problem)}
        iterations = {} if done is None else done.iterations
        kept |= {f"iterations.{name}": values for name, values in iterations.items()}
        with atomic.replace_file(self._path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                meta=np.frombuffer(json.dumps(meta).encode(), np.uint8),
                **kept,
                observation_mask=np.packbits(state.observation_mask),
                point_mask=np.packbits(state.point_mask),
            )

    def read(self, path: Path, prepared: Prepared) -> State:
        """Return the state that a file holds; see :meth:`read_by`."""
        start = prepared.start
        sizes = {"observation_mask": start.num_observations, "point_mask": start.num_points}

        def state(meta: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> State:
            masks = [
                np.unpackbits(arrays[name], count=size).astype(bool) for name, size in sizes.items()
            ]
            left = start.select(observations=masks[0], points=masks[1]).problem
            kept = {name: arrays[name] for name in estimates(left)}
            problem = with_estimates(left, kept, checked=True)
            done = meta["so_far"]
            if done is not None:
                done = result_of_record(done, arrays, problem, prepared.layout.options)
            return State.of_record(meta, problem, masks, done)

        return self.read_by(state, path)

    def read_by(
        self, make: Callable[[dict[str, Any], dict[str, NDArray[Any]]], Made], path: Path
    ) -> Made:
        """Return ``make`` of the record and the arrays of a file.

        Raises:
            InputError: the file is not a checkpoint, or belongs to another input or other options.
            OSError: the file cannot be read.
        """
        meta, arrays = _open(path)
        # Options that are newer than the file have their defaults.
        saved = {**fingerprint_of_options(SolveOptions()), **meta["fingerprint"]}
        _compare(path, saved, self._fingerprint)
        try:
            return make(meta, arrays)
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise InputError(
                f"{shown(path)}: expected a checkpoint, found a damaged one ({first_line(error)})"
            ) from None


def _record(result: Result) -> dict[str, Any]:
    return {
        "summary": dataclasses.asdict(result.summary),
        "factor_costs_before": result.factor_costs_before.tolist(),
        "factor_costs_after": result.factor_costs_after.tolist(),
        "active_bounds": [[list(key), name, side] for key, name, side in result.active_bounds],
        "build_time_in_seconds": result.build_time_in_seconds,
        "solve_time_in_seconds": result.solve_time_in_seconds,
    }


def result_of_record(
    record: dict[str, Any],
    arrays: dict[str, NDArray[Any]],
    problem: Problem,
    options: SolveOptions,
) -> Result:
    """Return the result of an unfinished round from the record and arrays of a checkpoint."""
    summary: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in record["summary"].items()
    }
    if summary.get("processes") is not None:
        summary["processes"] = ProcessRecord.of_dict(summary["processes"])
    return Result(
        problem=problem,
        initial_problem=problem,
        options=options,
        summary=Summary(**summary),
        iterations=_without_prefix(arrays),
        factor_costs_before=np.array(record["factor_costs_before"], float),
        factor_costs_after=np.array(record["factor_costs_after"], float),
        active_bounds=tuple(
            ((key[0], key[1]), name, side) for key, name, side in record["active_bounds"]
        ),
        build_time_in_seconds=record["build_time_in_seconds"],
        solve_time_in_seconds=record["solve_time_in_seconds"],
    )


def _without_prefix(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {
        name.partition(".")[2]: values
        for name, values in arrays.items()
        if name.startswith("iterations.")
    }


def _open(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the record and the arrays of a checkpoint."""
    try:
        with path.open("rb") as file:
            if file.read(2) != b"PK":
                raise ValueError("another kind of file")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                arrays = dict(archive.items())
        meta = json.loads(arrays.pop("meta").tobytes())
        if meta["schema"] != SCHEMA:
            raise ValueError(f"schema {meta['schema']!r}, expected {SCHEMA!r}")
        _ = meta["fingerprint"]["input"]
    except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{shown(path)}: expected a checkpoint of bundle, found something else "
            f"({first_line(error)})"
        ) from None
    return meta, arrays


def _compare(path: Path, saved: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    in_order = "order" not in saved or saved["order"] == now.get("order", saved["order"])
    if saved["input"] != now["input"] or not in_order:
        raise InputError(
            f"{shown(path)}: expected a checkpoint of this input, found one of another input"
        )
    for name in _names(saved, now):
        if saved.get(name) != now.get(name):
            raise InputError(
                f"{name}: expected {_short(saved.get(name))} as in the checkpoint {shown(path)}, "
                f"found {_short(now.get(name))}"
            )


def _names(saved: Mapping[str, Any], now: Mapping[str, Any]) -> Iterable[str]:
    return (name for name in dict.fromkeys([*now, *saved]) if name != "order")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


# Adjustment in segments: several solves of a few iterations, each from the end of the last.
#
# The state of a solver contains more than the values of its problem: the trust region radius, the
# chart of each rotation, and the scaling of the columns. A solve that restarts from saved values
# therefore takes different steps. For this reason a run that can be resumed always solves in
# segments: after every ``interval`` iterations the solver restarts from the values and the radius,
# which the checkpoint holds. A killed and resumed run then does the same solves from the same
# values as an uninterrupted run.
#
# Up to the tolerances, both runs end at the same minimum as a single solve, after about as many
# steps: a restart costs the set-up. With cheirality "zero" every segment, like every round,
# determines again which observations are behind their camera. A round starts at the initial radius
# of its options, because the filter changed the cost.

OF_A_SEGMENT = ("max_num_iterations", "initial_trust_region_radius")
"""Options that differ from segment to segment."""
COUNTS = ("num_residual_evaluations", "num_jacobian_evaluations", "num_linear_solves")


def solve_in_segments(
    solve: Callable[[Problem, SolveOptions, Progress | None], Result],
    problem: Problem,
    options: SolveOptions,
    interval: int,
    *,
    so_far: Result | None = None,
    progress: Progress | None = None,
    save: Callable[[Result], None],
) -> Result:
    """Adjust a problem in segments.

    ``so_far``: result of the previous segments; None without any. ``progress``: function called
    after each iteration; iteration numbers continue across segments.
    """
    while True:
        done = 0 if so_far is None else so_far.num_steps
        length = min(interval, options.max_num_iterations - done)
        changes: dict[str, Any] = {"max_num_iterations": length}
        if so_far is not None:
            last = float(so_far.iterations["trust_region_radius"][-1])
            changes["initial_trust_region_radius"] = min(last, LARGEST_RADIUS)
        segment = solve(
            problem,
            options.replace(**changes),
            progress if so_far is None else _counting_on(progress, so_far),
        )
        problem = segment.problem
        so_far = segment if so_far is None else join(so_far, segment)
        goes_on = (
            segment.summary.termination_type == "NO_CONVERGENCE"
            and segment.summary.is_solution_usable
            and not segment.summary.interrupted
            and 0 < segment.num_steps == length
            and so_far.num_steps < options.max_num_iterations
        )
        if not goes_on:
            given = {name: getattr(options, name) for name in OF_A_SEGMENT}
            return dataclasses.replace(so_far, options=so_far.options.replace(**given))
        save(so_far)


def join(first: Result, second: Result) -> Result:
    """Join the results of two segments into the result of one adjustment."""
    a, b = first.iterations, second.iterations
    iterations = {name: np.concatenate([a[name], b[name][1:]]) for name in a}
    tail = slice(len(a["iteration"]), None)
    for name in ("iteration", "cumulative_time_in_seconds"):
        iterations[name][tail] += a[name][-1]
    return dataclasses.replace(
        second,
        initial_problem=first.initial_problem,
        iterations=iterations,
        summary=_join_summaries(first.summary, second.summary),
        factor_costs_before=first.factor_costs_before,
        build_time_in_seconds=first.build_time_in_seconds + second.build_time_in_seconds,
        solve_time_in_seconds=first.solve_time_in_seconds + second.solve_time_in_seconds,
    )


def _join_summaries(first: Summary, second: Summary) -> Summary:
    changes: dict[str, Any] = {"initial_cost": first.initial_cost}
    times = [field.name for field in dataclasses.fields(Summary) if "_time_in_sec" in field.name]
    for name in (*COUNTS, *times):
        one, other = getattr(first, name), getattr(second, name)
        if one is not None and other is not None and one >= 0 and other >= 0:  # -1: not measured
            changes[name] = one + other
    # Each segment counts the evaluation at its start as a successful step.
    changes["num_successful_steps"] = first.num_successful_steps + second.num_successful_steps - 1
    changes["num_unsuccessful_steps"] = first.num_unsuccessful_steps + second.num_unsuccessful_steps
    steps = changes["num_successful_steps"] + changes["num_unsuccessful_steps"] - 1
    changes["message"] = re.sub(r"(Number of iterations: )\d+", rf"\g<1>{steps}", second.message)
    return dataclasses.replace(second, **changes)


def _counting_on(progress: Progress | None, so_far: Result) -> Progress | None:
    if progress is None:
        return None
    last = {name: values[-1] for name, values in so_far.iterations.items()}

    def later(values: dict[str, Any]) -> None:
        if values["iteration"] == 0:
            return  # already reported as the last iteration of the previous segment
        counted = {
            name: values[name] + last[name] for name in ("iteration", "cumulative_time_in_seconds")
        }
        progress({**values, **counted})

    return later
