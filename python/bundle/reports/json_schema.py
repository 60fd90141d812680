"""JSON schema (draft 2020-12) of the reports that ``--json FILE`` writes.

Parts that are dataclasses in the code (summaries, options, findings, errors, causes, candidates)
are derived from the dataclasses. Every report has the entries of :data:`COMMON`, and those of its
command; entries that exist for one kind of input only are optional. A number that is not finite is
null. Reports of ``validate`` have the recommended command line as their ``command``.
"""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Iterable
from typing import Any

from bundle.interface.finding import Finding
from bundle.interface.option_class import Options
from bundle.interface.option_classes import option_class
from bundle.reports.sections import SCHEMA

Schema = dict[str, Any]

_NUMBER: Schema = {"type": ["number", "null"]}
_COUNT: Schema = {"type": "integer", "minimum": 0}
_TEXT: Schema = {"type": "string"}
_LIST: Schema = {"type": "array"}
_OBJECT: Schema = {"type": "object"}
_MAYBE: Schema = {"type": ["object", "null"]}
_BOOLEAN: Schema = {"type": "boolean"}
_WORDS: Schema = {"type": "array", "items": _TEXT}
_INTEGER: Schema = {"type": "integer"}
_INDEX: Schema = {"type": ["integer", "null"]}
_SECONDS: Schema = {"type": "object", "additionalProperties": _NUMBER}
_OUTPUT: Schema = {"type": ["object", "null"], "properties": {"path": _TEXT, "format": _TEXT}}

_DEFINED = {
    "summary": "interface.summary.Summary",
    "finding": "interface.finding.Finding",
    "reprojection_error": "model.reprojection.ReprojectionError",
    "cause": "judging.triage.triage_result.TriageCause",
    "environment": "interface.environment.Environment",
    "tracking": "inertial.tracking.track_recording.Tracking",
}
"""Dataclasses with a definition of their own in the schema."""

_COUNTED = ("cameras", "images", "points", "observations", "outliers")
COMMON: dict[str, Schema] = {
    "schema": {"const": SCHEMA},
    "command": _TEXT,
    "version": _TEXT,
    "headline": _WORDS,
    "findings": {"type": "array", "items": {"$ref": "#/$defs/finding"}},
}
"""Entries of every report."""


def _options(*names: str) -> Schema:
    """Return the schema of options as used: those of one or more option classes."""
    properties: dict[str, Schema] = {}
    for name in names:
        properties |= _properties_of_options(option_class(name))
    return {"type": "object", "properties": properties}


def _errors() -> Schema:
    one = {"$ref": "#/$defs/reprojection_error"}
    return {"type": "object", "properties": {"before": one, "after": one}}


def _entries() -> dict[str, dict[str, Schema]]:
    records: Schema = {"type": "array", "items": _OBJECT}
    summary = {"$ref": "#/$defs/summary"}
    solved: dict[str, Schema] = {
        "summary": summary,
        "iterations": records,
    }
    timed = {"wall_time": _SECONDS}
    here = {"environment": {"$ref": "#/$defs/environment"}}
    notes = {"notes": _WORDS}
    tracking = {"tracking": {"$ref": "#/$defs/tracking"}}
    return {
        "align": {"georeference": _OBJECT, "output": _OUTPUT},
        "check": {
            **{"options": _OBJECT, "ok": _BOOLEAN, "subject": _TEXT, "noun": _TEXT},
            "verdict": {"enum": ["correct", "wrong", "undecided"]},
            **{"tolerance": _NUMBER, "num_checked": _COUNT, "num_skipped": _COUNT},
            "num_factors": _COUNT,
            **dict.fromkeys(("groups", "parameters", "worst", "histogram", "undecided"), _LIST),
            "gradient_checker": _OBJECT,
            **timed,
        },
        "compare": {
            **{"inputs": _LIST, "options": _OBJECT, "runs": {"type": "array", "items": _OBJECT}},
            **{"recommendation": _MAYBE, "interrupted": _BOOLEAN, "profiles": _LIST},
            **{"perturb": _NUMBER, "seed": _INTEGER, "repeat": _COUNT, "best_costs": _LIST},
            **{"at_minimum": _LIST, "timeout_in_seconds": _NUMBER, "memory_cap_in_bytes": _NUMBER},
            **{"structure": _MAYBE, "timeout": _NUMBER},
            **timed,
            **here,
        },
        "convert": {"output": _OUTPUT, "lost": _WORDS, **tracking},
        "covariance": {
            **{"options": _OBJECT, "gauge": _TEXT, "scale": _TEXT, "robust": _TEXT},
            **{"sigma0": _NUMBER, "dof": _INTEGER, "cameras": _LIST, "relative": _LIST},
            **{"points_without_parallax": _LIST, "held_pose_ids": _LIST, "output": _OUTPUT},
            **notes,
            **timed,
        },
        "diagnose": {
            **_of("analysis.diagnosis.diagnosis_result.Diagnosis"),
            **_of("analysis.diagnosis.diagnosis_result.GraphDiagnosis"),
            **{"options": _OBJECT, "ok": _BOOLEAN, "rank_gap": _NUMBER, "digits": _OBJECT},
            "weak_modes": {"type": "array", "items": {"required": ["sentence"]}},
            **timed,
        },
        "evaluate": {
            **{"reference": _OBJECT, "options": _options("EvaluateOptions"), "verdict": _TEXT},
            **{"num_shared": _COUNT, "images": _LIST, **notes},
            **dict.fromkeys(("num_pairs", "num_pairs_at_one_place"), _COUNT),
            **dict.fromkeys(("unit", "alignment", "auc_definition", "auc_description"), _TEXT),
            **dict.fromkeys(("position", "rotation", "auc", "auc_by_definition"), _MAYBE),
            **dict.fromkeys(("rra", "rta", "rpe", "similarity", "association"), _MAYBE),
            **dict.fromkeys(("missing", "lens_difference", "points", "movement"), _MAYBE),
            "size": _NUMBER,
        },
        "info": {
            **_of("analysis.statistics.description.Description"),
            **{"statistics": _OBJECT, "calibration": _OBJECT, "chi2": _OBJECT, **tracking},
            **{"degrees_of_freedom": _INTEGER, "bad_information": _LIST},
            **dict.fromkeys(("num_bad_information", "num_components"), _COUNT),
            "reprojection_error": {"anyOf": [{"$ref": "#/$defs/reprojection_error"}, _OBJECT]},
        },
        "inspect": {
            **_of("planning.inspection.inspection_result.Inspection"),
            **_of("planning.inspection.pose_graph_inspection.PoseGraphInspection"),
            **{"options": _OBJECT, "recommended_command": _TEXT, "nonzeros": _TEXT, **timed},
        },
        "merge": {"other": _OBJECT, "merge": _OBJECT, "output": _OUTPUT},
        "refine": {
            "options": _options("SolveOptions", "PoseGraphOptions"),
            **solved,
            "reprojection_error": _errors(),
            **{"held_cost": _NUMBER, "convergence": _OBJECT, "edits": _LIST, "rounds": _LIST},
            "cameras": _LIST,
            **{"worst_images": _LIST, "movement": _MAYBE, "held_out": _MAYBE, "part": _MAYBE},
            "deleted": {"type": "object", "additionalProperties": _COUNT},
            **dict.fromkeys(
                ("georeference", "gravity", "velocities", "certificate", "structure"), _MAYBE
            ),
            **dict.fromkeys(("chi2_by_kind", "left_out_edges", "rejected_edges"), _LIST),
            "camera_edits": _MAYBE,
            "output": _OUTPUT,
            **timed,
            **here,
        },
        "report": {"output": _OUTPUT, **notes, **timed},
        "synth": {
            **{"options": _OBJECT, "output": _OUTPUT, "ground_truth": _MAYBE, "contents": _OBJECT},
            **dict.fromkeys((f"num_{name}" for name in _COUNTED), _COUNT),
            **dict.fromkeys(("track_length", "observations_per_image"), _MAYBE),
            "reprojection_error": _MAYBE,
        },
        "triage": {
            **{"old": _OBJECT, "new": _OBJECT, "options": _options("TriageOptions"), **notes},
            "causes": {"type": "array", "items": {"$ref": "#/$defs/cause"}},
            "quantities": _LIST,
        },
        "validate": {
            **{"options": _OBJECT, "verdict": _TEXT, "recommended": _INDEX},
            **{"candidates": records, **notes},
            **dict.fromkeys(("num_folds", "num_held_out", "seed"), _COUNT),
            **dict.fromkeys(("clip", "sigma", "time_in_seconds"), _NUMBER),
            **{"best": _INDEX, "present": _INDEX, "rule": _MAYBE, "row_test": _MAYBE},
        },
        "vio": {
            **{"options": _options("WindowOptions"), "summary": _OBJECT, "output": _OUTPUT},
            **{"keyframes": records, "error": _MAYBE, **timed, **here, **tracking},
        },
    }


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
    return {name: {*COMMON, "input", *entries} for name, entries in _entries().items()}


def report_schema() -> Schema:
    """Return the schema of all reports. A report on several inputs has a list ``reports``."""
    branches = [
        {
            "if": _IS_COMMAND.get(
                name, {"properties": {"command": {"const": name}}, "required": ["command"]}
            ),
            "then": {"properties": entries, "required": list(_REQUIRED.get(name, ()))},
        }
        for name, entries in _entries().items()
    ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Report of bundle (--json FILE)",
        "type": "object",
        "properties": COMMON | {"input": _OBJECT},
        "required": list(COMMON),
        "allOf": branches,
        "$defs": {name: _of_dataclass(path) for name, path in _DEFINED.items()},
    }


def _of(path: str) -> dict[str, Schema]:
    """Return the entries that are fields of a result, without those of every report."""
    found = _of_dataclass(path)["properties"].items()
    return {name: schema for name, schema in found if name not in COMMON}


def _of_dataclass(path: str) -> Schema:
    """Return the schema of a dataclass, given by its place in the package."""
    module, _, name = path.rpartition(".")
    return record_schema(getattr(importlib.import_module(f"bundle.{module}"), name))


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
    """Return the schema of a value by the text of its type."""
    choices = [_of_plain_type(part.strip()) for part in _split(text, "|")]
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
    }
    if name in plain:
        return plain[name]
    if name in ("tuple", "list", "Sequence") and rest.endswith(", ...]"):
        return {"type": "array", "items": _of_type(rest.removesuffix(", ...]"))}
    if name in ("tuple", "list", "Sequence", "NDArray"):
        return _LIST
    return _OBJECT  # another record


def _split(text: str, separator: str) -> Iterable[str]:
    """Split a type at a separator outside brackets."""
    return re.split(rf"\s*{re.escape(separator)}\s*(?![^\[]*\])", text)


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
