"""Reports of refine, vio and compare as read by triage, and checks of their structure."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bundle._core import __version__
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.judging.triage.difference import SolveFacts, flight_facts, solve_facts

SCHEMA = 1
MOST_DIGITS = 18
COMMANDS = ("refine", "vio", "compare")
SIZES = {"num_poses": "poses", "num_images": "images", "duration": "seconds"}
"""Counts that distinguish two inputs, with their nouns."""

Entry = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class SolveReport:
    """A report of one command."""

    path: str  # path of the report
    command: str  # "refine", "vio" or "compare"
    inputs: tuple[Entry, ...]  # path, format, counts and digests of each input
    environment: Entry  # machine, load and versions; empty in a report without them
    solves: Mapping[tuple[int, str], SolveFacts]  # facts of the solves by (input, method)


def read_report(path: str | os.PathLike[str]) -> SolveReport:
    """Read the JSON that ``--json FILE`` wrote."""
    place = shown(os.fspath(path))
    expected = f"{place}: expected a report of bundle refine, vio or compare (--json FILE)"
    try:
        text = Path(as_path(path)).read_text(encoding="utf-8", errors="replace")
        report = json.loads(text, parse_constant=_finite, parse_float=_finite, parse_int=_whole)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{expected}, found no JSON: {error}") from None
    if not isinstance(report, dict) or not isinstance(report.get("command"), str):
        raise InputError(f"{expected}, found {brief(report)}")
    if report["command"] not in COMMANDS:
        raise InputError(f"{expected}, found one of bundle {brief(report['command'])[1:-1]}")
    for name, known in (("schema", SCHEMA), ("version", __version__)):
        if report.get(name) != known:
            raise InputError(
                f"{place}: expected a report of {name} {known}, found {name} "
                f"{brief(report.get(name))}; solve the input again with this version"
            )
    has_models = report["command"] == "compare" and "inputs" in report
    check_shape(report, SHAPES["compare models" if has_models else report["command"]], place)
    for k, run in enumerate(report["runs"] if "inputs" in report else ()):
        if run["input"] not in range(len(report["inputs"])):
            raise InputError(
                f"{place}: runs[{k}].input: expected the index of one of "
                f"{len(report['inputs'])} inputs, found {brief(run['input'])}"
            )
    return _report(str(path), report)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"expected finite numbers, found {brief(text)[1:-1]}")
    return number


def _whole(text: str) -> float:
    """Return a whole number: as an int, or as a float if it has too many digits for a count."""
    return int(text) if len(text) < MOST_DIGITS else _finite(text)


def same_input(old: SolveReport, new: SolveReport) -> None:
    """Refuse reports of different commands or inputs.

    A file may have another name in each run, and its contents may grow under the same name. Inputs
    are different if both name and size differ.
    """
    place = shown(new.path)
    if old.command != new.command:
        raise InputError(
            f"{place}: expected a report of bundle {old.command} as {shown(old.path)}, found one "
            f"of bundle {new.command}"
        )
    if len(old.inputs) != len(new.inputs):
        raise InputError(
            f"{place}: expected {len(old.inputs)} inputs as in {shown(old.path)}, found "
            f"{len(new.inputs)}"
        )
    for before, after in zip(old.inputs, new.inputs, strict=True):
        sizes = [name for name in SIZES if name in before or name in after]
        is_same_size = all(before.get(name) == after.get(name) for name in sizes)
        is_same_kind = before["format"] == after["format"]
        if is_same_kind and (is_same_size or _name(before) == _name(after)):
            continue
        raise InputError(
            f"{place}: expected a report on the input of {shown(old.path)}, "
            f"{_described(before)}, found {_described(after)}"
        )


def _name(given: Entry) -> str:
    return Path(given["path"] or "").name.partition(".")[0]


def _described(given: Entry) -> str:
    counts = [f"{given[name]:.6g} {noun}" for name, noun in SIZES.items() if name in given]
    return f"{shown(given['path'] or 'a problem')} ({given['format']}, {', '.join(counts)})"


def _report(path: str, report: Entry) -> SolveReport:
    inputs = report["inputs"] if "inputs" in report else [report["input"]]
    solves = {
        "refine": _refined,
        "vio": lambda given: {(0, ""): flight_facts(given)},
        "compare": _compared_models if "inputs" in report else _compared_graph,
    }[report["command"]](report)
    return SolveReport(
        path=path,
        command=report["command"],
        inputs=tuple(dict(given) for given in inputs),
        environment=report.get("environment") or {},
        solves=solves,
    )


def _refined(report: Entry) -> dict[tuple[int, str], SolveFacts]:
    structure = report.get("structure") or {}
    parts = report["options"], report["summary"], report["iterations"], structure
    return {(0, ""): solve_facts(*parts, environment=report.get("environment"))}


def _compared_graph(report: Entry) -> dict[tuple[int, str], SolveFacts]:
    varied = ("backend", "trust_region_strategy_type", "ordering", "num_threads")
    structure = report.get("structure") or {}
    solves = {}
    for run in report["runs"]:
        if run["summary"] is None or run["iterations"] is None:  # the run failed
            continue
        options = {**report["options"], **{name: run[name] for name in varied}}
        name = f"{run['name']}, {run['num_threads']} threads"
        solves[0, name] = solve_facts(
            options, run["summary"], run["iterations"], structure, name, run["time_in_seconds"]
        )
    return solves


def _compared_models(report: Entry) -> dict[tuple[int, str], SolveFacts]:
    solves = {}
    for run in report["runs"]:
        if not run["measurements"]:
            continue
        last, method = run["measurements"][-1], run["method"]
        name = " ".join(str(value) for key, value in method.items() if key != "num_threads")
        name += f", {method['num_threads']} threads"
        solves[run["input"], name] = solve_facts(
            {**report["options"], **method},
            last["summary"],
            last["iterations"],
            {},
            name,
            run["total_time_in_seconds"],
        )
    return solves


# Shape of the reports that a triage reads: which entries they have, and of which kind.
#
# A shape is one of the kinds below; a list with the shape of its items; or a table with shapes by
# name. A name with a final "?" is optional, "*" is any other name, and ``Maybe`` allows null.

NUMBER, TEXT, FLAG, ANY = "a number", "a string", "true or false", "any value"
KINDS: Mapping[str, Any] = {NUMBER: int | float, TEXT: str, FLAG: bool, ANY: object}


@dataclass(frozen=True)
class Maybe:
    """A shape, or null."""

    shape: Any


MAYBE_NUMBER = Maybe(NUMBER)

ITERATIONS = [
    {
        **{"step_is_successful": FLAG, "trust_region_radius?": MAYBE_NUMBER},
        "gradient_max_norm?": MAYBE_NUMBER,
    }
]

SUMMARY = {
    **{"initial_cost": MAYBE_NUMBER, "final_cost": MAYBE_NUMBER},
    **{"termination_type": TEXT, "is_solution_usable": FLAG, "warning_kinds": [TEXT]},
    **{"num_successful_steps": NUMBER, "num_unsuccessful_steps": NUMBER},
    **{"num_threads_used": NUMBER, "total_time_in_seconds": NUMBER},
    **{"backend_used": TEXT, "linear_solver_type_used": TEXT, "factor_ordering?": Maybe(TEXT)},
    **{"num_parameters_reduced?": MAYBE_NUMBER, "num_residuals_reduced?": MAYBE_NUMBER},
    **{"num_information_nonzeros?": MAYBE_NUMBER, "num_reduced_nonzeros?": MAYBE_NUMBER},
    **{"num_factor_nonzeros?": MAYBE_NUMBER, "factor_flops?": MAYBE_NUMBER},
    "least_factor_flops?": MAYBE_NUMBER,
}

INPUT = {
    **{"path": Maybe(TEXT), "format": TEXT, "digests?": Maybe({"*": TEXT})},
    **{f"num_{name}?": MAYBE_NUMBER for name in ("poses", "edges", "images", "points")},
    "duration?": MAYBE_NUMBER,
}

COMMON = {
    "options": {"*": ANY},
    "environment?": Maybe(
        {
            **{"cpu_model?": Maybe(TEXT), "versions?": Maybe({"*": Maybe(TEXT)})},
            **{"num_cores?": MAYBE_NUMBER, "load_before?": MAYBE_NUMBER},
            **{"waiting?": MAYBE_NUMBER, "preemptions?": MAYBE_NUMBER},
        }
    ),
    "structure?": Maybe({"densest?": MAYBE_NUMBER}),
}

KEYFRAME = {
    **dict.fromkeys(("num_rows", "num_iterations", "num_rejected", "num_rejected_tracks"), NUMBER),
    **{"costs": {"*": NUMBER}, "alarms": [TEXT], "out_of_time": FLAG},
    **{"nullity": MAYBE_NUMBER, "expected_nullity": NUMBER, "least_radius?": MAYBE_NUMBER},
    **{f"num_{name}?": MAYBE_NUMBER for name in ("columns", "prior_columns")},
    **{f"num_{name}_nonzeros?": MAYBE_NUMBER for name in ("information", "reduced", "factor")},
}

SHAPES = {
    "refine": {"input": INPUT, "summary": SUMMARY, "iterations": ITERATIONS, **COMMON},
    "vio": {
        **{"input": INPUT, "summary": {"is_solution_usable": FLAG}, "keyframes": [KEYFRAME]},
        **{"wall_time": {"solve": NUMBER}, "error": Maybe({"ate": MAYBE_NUMBER})},
        **COMMON,
    },
    "compare": {
        "input": INPUT,
        "runs": [
            {
                **{"name": TEXT, "backend": TEXT, "trust_region_strategy_type": TEXT},
                **{"ordering": TEXT, "num_threads": NUMBER, "time_in_seconds": MAYBE_NUMBER},
                **{"summary": Maybe(SUMMARY), "iterations": Maybe(ITERATIONS)},
            }
        ],
        **COMMON,
    },
    "compare models": {
        "inputs": [INPUT],
        "runs": [
            {
                **{"input": NUMBER, "method": {"num_threads": NUMBER, "*": TEXT}},
                "total_time_in_seconds": MAYBE_NUMBER,
                "measurements": [{"summary": SUMMARY, "iterations": ITERATIONS}],
            }
        ],
        **COMMON,
    },
}


def check_shape(value: Any, shape: Any, place: str, name: str = "") -> None:
    """Refuse a value that lacks required entries.

    ``shape``: expected shape. ``name``: names of the entries that lead to the value, such as
    "summary.final_cost".
    """
    if isinstance(shape, Maybe):
        if value is not None:
            check_shape(value, shape.shape, place, name)
    elif isinstance(shape, list):
        _expect(isinstance(value, list), "a list", value, place, name)
        for k, item in enumerate(value):
            check_shape(item, shape[0], place, f"{name}[{k}]")
    elif isinstance(shape, dict):
        _expect(isinstance(value, dict), "a table", value, place, name)
        parent = f"{name}." if name else ""
        known = set()
        for entry, part in shape.items():
            key = entry.removesuffix("?")
            known.add(key)
            if key in value:
                check_shape(value[key], part, place, parent + key)
            elif entry == key != "*":
                raise InputError(f"{place}: expected an entry {brief(parent + key)}, it is missing")
        for key in value.keys() - known if "*" in shape else ():
            check_shape(value[key], shape["*"], place, parent + key)
    else:
        is_kind = isinstance(value, KINDS[shape])
        if shape == NUMBER:
            is_kind = is_kind and not isinstance(value, bool)
        _expect(is_kind, shape, value, place, name)


def _expect(is_kind: bool, kind: str, value: Any, place: str, name: str) -> None:
    if not is_kind:
        raise InputError(f"{place}: {name}: expected {kind}, found {brief(value)}")
