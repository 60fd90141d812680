"""Comparisons from the reports that ``bundle compare --json FILE`` writes."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import as_path
from bundle.errors import InputError, brief, shown
from bundle.interface.environment import Environment
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.planning.comparison.comparison_result import (
    ComparedProblem,
    Comparison,
    Recommendation,
)
from bundle.planning.comparison.measured_run import Measurement, Prediction, Run
from bundle.planning.comparison.method import Method
from bundle.planning.comparison.profiles import PerformanceProfile

Entry = Mapping[str, Any]
_Kind = TypeVar("_Kind")

_TRACE = ("iteration", "cost", "step_is_successful", "cumulative_time_in_seconds")


def read_comparison(path: str | os.PathLike[str]) -> Comparison:
    """Return the comparison that ``bundle compare --json FILE`` wrote.

    It has all runs, repeats, iterations and conditions, so that ``bundle.pictures`` and
    ``bundle.html.write_comparison`` draw the same figures as at the time of the measurement.

    Raises:
        InputError: the file is not a complete report on reconstructions.
        OSError: the file cannot be read.

    Example:
        >>> comparison = bundle.read_comparison("measured.json")
        >>> bundle.pictures.draw_cost_against_time(ax, comparison)
    """
    text = Path(as_path(path)).read_text(encoding="utf-8", errors="replace")
    place = shown(os.fspath(path))
    expected = f"{place}: expected a report of bundle compare --json"
    try:
        report = json.loads(text)
    except ValueError as error:
        raise InputError(f"{expected}, found no JSON: {error}") from None
    if not isinstance(report, dict) or report.get("command") != "compare":
        found = report.get("command") if isinstance(report, dict) else report
        raise InputError(f"{expected}, found {brief(found)}")
    if "inputs" not in report:
        raise InputError(f"{expected} on reconstructions, found a comparison on a pose graph")
    try:
        return _comparison(report)
    except KeyError as error:
        raise InputError(f"{place}: expected an entry {error}, it is missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{expected}, found other contents: {error}") from None


def _comparison(report: Entry) -> Comparison:
    found = report["recommendation"]
    return Comparison(
        problems=tuple(_problem(k, entry) for k, entry in enumerate(report["inputs"])),
        runs=tuple(map(_run, report["runs"])),
        profiles=tuple(map(_profile, report["profiles"])),
        recommendation=None if found is None else _recommendation(found),
        options=_options(report["options"]),
        repeat=report["repeat"],
        timeout=report["timeout_in_seconds"],
        memory_cap_in_bytes=report["memory_cap_in_bytes"],
        interrupted=report["interrupted"],
        wall_time_in_seconds=report["wall_time"]["total"],
        environment=_record(Environment, report["environment"]),
        perturb=report["perturb"],
        seed=report["seed"],
    )


def _problem(index: int, entry: Entry) -> ComparedProblem:
    path = entry["path"]
    name = f"problem {index + 1}" if path is None else path
    return _record(ComparedProblem, {**entry, "name": name, "is_file": path is not None})


def _options(entry: Entry) -> SolveOptions:
    known = {field.name: field.default for field in dataclasses.fields(SolveOptions)}
    given = {name: value for name, value in entry.items() if name in known and value is not None}
    return SolveOptions(**given)


def _method(entry: Entry) -> Method:
    return _record(Method, {k: v.lower() if isinstance(v, str) else v for k, v in entry.items()})


def _run(entry: Entry) -> Run:
    unfinished, prediction = entry["unfinished"], entry["prediction"]
    return Run(
        problem=entry["input"],
        method=_method(entry["method"]),
        outcome=entry["outcome"].lower(),
        message=entry["message"],
        measurements=tuple(map(_measurement, entry["measurements"])),
        unfinished=_columns(unfinished) if unfinished else None,
        prediction=None if prediction is None else _record(Prediction, prediction),
        distance_in_sigmas=_number(entry["distance_in_sigmas"]),
        num_points_elsewhere=entry["num_points_elsewhere"],
        minimum=-1 if entry["minimum"] is None else entry["minimum"],
    )


def _measurement(entry: Entry) -> Measurement:
    added = entry["added_memory_in_bytes"]
    changed = {
        "summary": _record(Summary, {**entry["summary"], "processes": None}),
        "iterations": _columns(entry["iterations"]),
        "added_memory_in_bytes": -1 if added is None else added,
    }
    return _record(Measurement, {**entry, **changed})


def _profile(entry: Entry) -> PerformanceProfile:
    ratios = tuple(math.inf if ratio is None else ratio for ratio in entry["ratios"])
    return _record(
        PerformanceProfile, {**entry, "method": _method(entry["method"]), "ratios": ratios}
    )


def _recommendation(entry: Entry) -> Recommendation:
    foreseen = tuple(one and _method(one) for one in entry["foreseen"])
    return _record(
        Recommendation, {**entry, "method": _method(entry["method"]), "foreseen": foreseen}
    )


def _record(kind: type[_Kind], entry: Entry) -> _Kind:
    """Return a dataclass from its fields in JSON: lists are tuples, and null is NaN in numbers."""
    values = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        value = entry[field.name]
        if value is None and field.type == "float":
            value = math.nan
        values[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)


def _columns(rows: Sequence[Entry]) -> dict[str, NDArray[Any]]:
    """Return one array per entry of the iterations; numbers that are null become NaN."""
    if not rows:
        return {name: np.empty(0) for name in _TRACE}
    return {name: np.array([_unknown(row[name]) for row in rows]) for name in rows[0]}


def _unknown(value: Any) -> Any:
    return math.nan if value is None else value


def _number(value: float | None) -> float:
    return math.nan if value is None else value
