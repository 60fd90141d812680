"""Schema of the JSON reports (draft 2020-12), and ``save_report``.

It is derived from the classes of results, options and records. Every report has the entries of
:data:`COMMON`, and those of its command; entries that exist for one kind of input only are
optional. A number that is not finite is null. Reports of ``validate`` have the recommended command
line as their ``command``.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from bundle.base.arrays import check_type
from bundle.base.paths import as_path
from bundle.georeference.measurements import ROWS
from bundle.graphs.factors.factor_graph import GraphResult
from bundle.graphs.pose_graphs.edge_weights import densest_set
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.environment import Environment
from bundle.interface.finding import Finding
from bundle.interface.option_class import Options, option_class
from bundle.interface.solve_record import SolveRecord
from bundle.io.atomic import atomic_write as atomic
from bundle.model.content_digests import content_digests
from bundle.reports.sections import SCHEMA, Report, dumps, records
from bundle.reports.terminal.inputs import about_input
from bundle.reports.terminal.solve_data import solve_options
from bundle.solving.result import Result

Schema = dict[str, Any]

_NUMBER: Schema = {"type": ["number", "null"]}
_TEXT: Schema = {"type": "string"}
_LIST: Schema = {"type": "array"}
_OBJECT: Schema = {"type": "object"}
_BOOLEAN: Schema = {"type": "boolean"}
_INTEGER: Schema = {"type": "integer"}

_DEFINED = {
    "summary": "interface.summary.Summary",
    "finding": "interface.finding.Finding",
    "reprojection_error": "model.residuals.ReprojectionError",
    "cause": "judging.triage.triage_result.TriageCause",
    "environment": "interface.environment.Environment",
    "tracking": "inertial.tracking.track_recording.Tracking",
}
"""Dataclasses with a definition of their own in the schema."""

_REFERENCES: dict[str, Schema] = {
    path.rpartition(".")[2]: {"$ref": f"#/$defs/{name}"} for name, path in _DEFINED.items()
}

COMMON: dict[str, Schema] = {
    "schema": {"const": SCHEMA},
    "command": _TEXT,
    "version": _TEXT,
    "headline": {"type": "array", "items": _TEXT},
    "findings": {"type": "array", "items": _REFERENCES["Finding"]},
}
"""Entries of every report."""

_SHARED = {
    "output": "Output",
    "wall_time": "dict[str, float]",
    "environment": "Environment",
    "tracking": "Tracking",
    "notes": "tuple[str, ...]",
    "options": "dict",
}
"""Types of entries with one meaning in all reports."""

_REPORTS = {
    "align": "georeference:dict output",
    "check": "checking.gradient_report.GradientReport.* graphs.factors.factor_report.FactorCheck "
    "options verdict num_factors histogram:tuple[dict,...] wall_time",
    "compare": "planning.comparison.comparison_result.Comparison "
    "planning.comparison.graph_comparison.GraphComparison inputs:list options runs recommendation "
    "interrupted profiles perturb seed repeat best_costs:list at_minimum:list "
    "timeout_in_seconds:float memory_cap_in_bytes:float structure:dict|None timeout wall_time "
    "environment",
    "convert": "output lost:tuple[str,...] tracking",
    "covariance": "analysis.uncertainty.covariance_result.Covariance options gauge scale robust "
    "sigma0 dof unit cameras:list relative:list points_without_parallax:list held_pose_ids output "
    "notes wall_time",
    "diagnose": "analysis.diagnosis.diagnosis_result.Diagnosis.* options ok rank_gap digits:dict "
    "wall_time",
    "dry-run": "run:str reads:list writes:list flags:str",
    "evaluate": "judging.evaluation.evaluation_result.Evaluation reference:dict "
    "options:EvaluateOptions verdict num_shared images notes num_pairs:int "
    "num_pairs_at_one_place:int unit alignment auc_definition auc_description:str "
    "position:dict|None rotation:dict|None auc:dict|None auc_by_definition:dict|None "
    "rra:dict|None rta:dict|None rpe:dict|None similarity:dict|None association:dict|None "
    "missing:dict|None lens_difference points movement size",
    "influence": "analysis.uncertainty.influence.Influence options on unit value sigma sigma0 "
    "share_of_factors hangs_on num_observations without changes notes "
    "wall_time",
    "info": "analysis.statistics.description.Description.* statistics:dict calibration:dict "
    "chi2:dict tracking degrees_of_freedom:int bad_information:list num_bad_information:int "
    "num_components:int reprojection_error:dict",
    "inspect": "planning.inspection.inspection_result.Inspection.* "
    "planning.inspection.elimination_costs.FactorGraphInspection.* num_poses num_free_poses "
    "options recommended_command:str nonzeros:str wall_time",
    "merge": "other:dict merge:dict output",
    "plan": "analysis.uncertainty.measurement_plan.Plan options on unit value sigma proposals "
    "together notes wall_time",
    "refine": "solving.result.Result graphs.pose_graphs.pose_graph_result.PoseGraphResult "
    "options:SolveOptions+PoseGraphOptions summary iterations:tuple[dict,...] "
    "held_cost:float convergence:dict edits rounds tracks cameras:list worst_images "
    "movement:dict|None held_out part deleted:dict[str,int] "
    "certificate structure:dict|None chi2_by_kind:list left_out_edges:list "
    "rejected_edges:list camera_edits:dict|None output wall_time environment",
    "report": "output notes wall_time",
    "synth": "options output ground_truth:dict|None contents:dict num_cameras:int num_images:int "
    "num_points:int num_observations:int num_outliers:int track_length:dict|None "
    "observations_per_image:dict|None reprojection_error:dict|None",
    "triage": "judging.triage.triage_result.Triage old:dict new:dict options:TriageOptions notes "
    "causes quantities",
    "validate": "judging.validation.validation_result.Validation options verdict "
    "recommended:int|None candidates notes num_folds num_held_out:int seed clip sigma "
    "time_in_seconds best:int|None present:int|None rule row_test",
    "vio": "inertial.vio.odometry.OdometryResult options:WindowOptions summary:dict output "
    "keyframes error:dict|None wall_time environment tracking",
}
"""Results and entries of each command's reports: ``path.Class`` (with ``.*``: all its fields are
entries), and ``name`` with the type of the result's attribute, or ``name:type``."""

_OTHERS: dict[tuple[str, str], Schema] = {
    ("check", "verdict"): {"enum": ["correct", "wrong", "undecided"]},
    ("diagnose", "weak_modes"): {"type": "array", "items": {"required": ["sentence"]}},
    ("refine", "reprojection_error"): {
        "type": "object",
        "properties": dict.fromkeys(("before", "after"), _REFERENCES["ReprojectionError"]),
    },
}
"""Entries whose form no type describes."""


def _entries(command: str) -> dict[str, Schema]:
    words = _REPORTS[command].split()
    if command == "refine":
        words += dict.fromkeys(f"{row.entry}:dict|None" for row in ROWS)
    names = [word.partition(":") for word in words if "." not in word.partition(":")[0]]
    types: dict[str, str] = {}
    whole: dict[str, str] = {}
    for word in reversed([word for word in words if "." in word.partition(":")[0]]):
        kind = _class(word.removesuffix(".*"))
        fields = {field.name: str(field.type) for field in dataclasses.fields(kind)}
        types |= _properties(kind) | fields
        whole = {**whole, **fields} if word.endswith(".*") else whole
    types |= _SHARED
    hidden = {*COMMON, "details"}
    given = {name: types[name] for name in whole if name not in hidden}
    given |= {name: text or types[name] for name, _, text in names}
    made = {name: _of_type(text) for name, text in given.items()}
    for name, one in made.items():
        if one == _INTEGER and name.startswith("num_"):
            made[name] = one | {"minimum": 0}
    return made | {name: one for (of, name), one in _OTHERS.items() if of == command}


_IS_COMMAND: dict[str, Schema] = {"validate": {"required": ["candidates", "num_folds"]}}
"""Tests of the commands whose reports do not have their name as ``command``."""

_REQUIRED = {
    "check": ("ok", "verdict"),
    "convert": ("output", "lost"),
    "covariance": ("output",),
    "diagnose": ("nullity", "expected_nullity"),
    "evaluate": ("verdict", "num_shared"),
    "refine": ("options", "summary", "iterations"),
    "triage": ("causes",),
    "validate": ("candidates", "recommended"),
    "vio": ("keyframes", "summary"),
}


def described_entries() -> dict[str, set[str]]:
    """Return the names of the described entries of each command's reports."""
    return {name: {*COMMON, "input", "config", *_entries(name)} for name in _REPORTS}


def report_schema() -> Schema:
    """Return the schema of all reports. A report on several inputs has a list ``reports``."""
    branches = [
        {
            "if": _IS_COMMAND.get(
                name, {"properties": {"command": {"const": name}}, "required": ["command"]}
            ),
            "then": {"properties": _entries(name), "required": list(_REQUIRED.get(name, ()))},
        }
        for name in _REPORTS
    ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Report of bundle (--json FILE)",
        "type": "object",
        "properties": COMMON | {"input": _OBJECT, "config": _OBJECT},
        "required": list(COMMON),
        "allOf": branches,
        "$defs": {name: record_schema(_class(path)) for name, path in _DEFINED.items()},
    }


def _class(path: str) -> type:
    module, _, name = path.rpartition(".")
    found: type = getattr(importlib.import_module(f"bundle.{module}"), name)
    return found


def _properties(kind: type) -> dict[str, str]:
    found = {name: inspect.getattr_static(kind, name) for name in dir(kind)}
    getters = {
        name: one.func if isinstance(one, cached_property) else one.fget
        for name, one in found.items()
        if isinstance(one, property | cached_property)
    }
    return {name: str(one.__annotations__["return"]) for name, one in getters.items() if one}


def record_schema(kind: type) -> Schema:
    """Return the schema of a dataclass."""
    fields = dataclasses.fields(kind)
    properties = {field.name: _of_type(str(field.type)) for field in fields}
    required = [
        field.name
        for field in fields
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]
    if kind is Finding:
        required += ["command", "evidence"]  # reports always write them
    return {"type": "object", "properties": properties, "required": required}


def _of_type(text: str) -> Schema:
    choices = [_of_plain_type(part.strip()) for part in re.split(r"\s*\|\s*(?![^\[]*\])", text)]
    kinds: list[str] = []
    for choice in choices:
        kind = choice.get("type", [])
        kinds += [kind] if isinstance(kind, str) else kind
    if len(choices) == 1:
        return choices[0]
    if not all("type" in choice for choice in choices):
        return {}
    merged: Schema = {"type": sorted(set(kinds))}
    for choice in choices:
        merged |= {key: value for key, value in choice.items() if key != "type"}
    return merged


def _of_plain_type(text: str) -> Schema:
    name, _, rest = text.partition("[")
    plain: dict[str, Schema] = {
        **{"int": _INTEGER, "float": _NUMBER, "str": _TEXT, "bool": _BOOLEAN},
        **{"None": {"type": "null"}, "dict": _OBJECT, "Mapping": _OBJECT},
        **{"Any": {}, "Key": {}, "Array": _LIST},
        "Output": {"type": ["object", "null"], "properties": {"path": _TEXT, "format": _TEXT}},
        **_REFERENCES,
    }
    if name.endswith("Options"):
        kinds = map(option_class, name.split("+"))
        of_all = {key: one for kind in kinds for key, one in _properties_of_options(kind).items()}
        return {"type": "object", "properties": of_all}
    if name in ("dict", "Mapping") and rest:
        values = _of_type(rest.partition(",")[2].strip().removesuffix("]"))
        return {"type": "object", "additionalProperties": values} if values else _OBJECT
    if name in plain:
        return plain[name]
    if name in ("tuple", "list", "Sequence") and re.search(r", ?\.\.\.\]$", rest):
        return {"type": "array", "items": _of_type(re.sub(r", ?\.\.\.\]$", "", rest))}
    if name in ("tuple", "list", "Sequence", "NDArray"):
        return _LIST
    return _OBJECT  # another record


def _properties_of_options(kind: type[Options]) -> dict[str, Schema]:
    found: dict[str, Schema] = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if field.default is None:
            found[field.name] = {}
        elif field.metadata["choices"] is not None or isinstance(field.default, str):
            found[field.name] = _TEXT
        elif isinstance(field.default, bool):
            found[field.name] = _BOOLEAN
        elif isinstance(field.default, int):
            found[field.name] = _INTEGER
        elif isinstance(field.default, float):
            found[field.name] = _NUMBER
        elif isinstance(field.default, tuple):
            found[field.name] = _LIST
    return found


# ``save_report``: the JSON report of a solve in Python, for ``bundle triage``.


def save_report(result: SolveRecord, path: str | os.PathLike[str], *, name: str = "") -> None:
    """Write the JSON report of a solve: input, options, summary, iterations, environment.

    :func:`bundle.triage` compares two such files, or one with that of ``bundle refine --json``.

    Args:
        result: result of :func:`bundle.solve` or :meth:`bundle.FactorGraph.solve`.
        path: path of the file.
        name: name of the input; two reports of one input have the same.

    Raises:
        InputError: ``result`` is not a result of a solve.
        OSError: the file cannot be written.
    """
    check_type("result", result, SolveRecord)
    about, structure = _about(result, name)
    report = Report(
        command="refine",
        input=about,
        headline=[result.outcome],
        warnings=result.summary.warnings,
        data={
            "options": solve_options(result.options),
            "summary": result.summary,
            "iterations": records(result.iterations),
            "structure": structure,
            "environment": Environment.now().finished(),
        },
    )
    atomic.write_text(Path(as_path(path)), dumps(report.json()))


def _about(result: SolveRecord, name: str) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return the JSON entries of the input, and facts on the structure of its matrix."""
    if isinstance(result, PoseGraphResult):
        graph = result.initial_problem
        about = about_input(name or graph.path, graph) | {"digests": content_digests(graph)}
        return about, {"densest": densest_set(graph.edges)}
    if isinstance(result, Result):
        given = result.initial_problem
        return about_input(name, given) | {"digests": content_digests(given)}, {}
    assert isinstance(result, GraphResult)
    summary = result.summary
    counts = {"num_variables": len(result.values), "num_factors": summary.num_residual_blocks}
    return {"path": name, "format": "factor graph", **counts}, {}
