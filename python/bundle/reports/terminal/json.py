"""Reports for programs: dictionaries of JSON's own types."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle._core import __version__
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.reports.terminal.timing import WallTime
from bundle.solving.camera_changes import camera_changes
from bundle.solving.result import Result
from bundle.solving.sensor_changes import sensor_changes

if TYPE_CHECKING:
    from bundle.analysis.statistics.description import Description
    from bundle.editing.cameras.edit_record import CameraEdits
    from bundle.georeference.georeferenced import Georeference
    from bundle.graphs.loops.loop_closing import LoopClosing

__all__ = [
    "SCHEMA",
    "camera_edits",
    "conversion",
    "dumps",
    "heading",
    "information",
    "plain",
    "records",
    "refinement",
    "result",
    "several",
    "solve_options",
]

SCHEMA = 1


def heading(command: str, path: str, problem: Problem) -> dict[str, Any]:
    """Return what every report begins with: schema, command, version and input."""
    return {
        "schema": SCHEMA,
        "command": command,
        "version": __version__,
        "input": {
            "path": path,
            "format": problem.format,
            "num_cameras": problem.num_cameras,
            "num_images": problem.num_images,
            "num_points": problem.num_points,
            "num_observations": problem.num_observations,
            **_rig_counts(problem),
        },
    }


def _rig_counts(problem: Problem) -> dict[str, int]:
    """Return the counts of rigs of several sensors; nothing where there are none."""
    names = ("num_rigs", "num_frames", "num_sensors") if problem.num_frames else ()
    return {name: getattr(problem, name) for name in names}


def several(command: str, reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the reports on several inputs as one."""
    return {"schema": SCHEMA, "command": command, "version": __version__, "reports": reports}


def result(solved: Result) -> dict[str, Any]:
    """Return options, summary, iterations and reprojection errors of a solve.

    Enumerations are upper-case, iterations one dictionary each, and what is not finite is None.
    """
    report: dict[str, Any] = plain(
        {
            "options": solve_options(solved.options),
            "summary": dataclasses.asdict(solved.summary),
            "iterations": records(solved.iterations),
            "reprojection_error": {
                "before": dataclasses.asdict(solved.reprojection_error_before),
                "after": dataclasses.asdict(solved.reprojection_error_after),
            },
        }
    )
    return report


def refinement(
    path: str,
    problem: Problem,
    solved: Result,
    wall: WallTime,
    output: dict[str, str] | None,
    more_options: Mapping[str, Any] | None = None,
    georeference: Georeference | None = None,
    edits: CameraEdits | None = None,
    closed: LoopClosing | None = None,
) -> dict[str, Any]:
    """Return the report of `bundle refine`; `output` is None where nothing was written.

    `more_options` are those beside the options of the solve.
    """
    about = result(solved)
    about["options"] |= plain(more_options or {})
    rounds = {"rounds": [dataclasses.asdict(done) for done in solved.rounds]}
    place = {} if georeference is None else {"georeference": plain(georeference.asdict())}
    return {
        **heading("refine", path, problem),
        **camera_edits(edits),
        **({} if closed is None else {"loops": plain(closed.asdict())}),
        **about,
        **(plain(rounds) if solved.rounds else {}),
        **({"part": plain(dataclasses.asdict(solved.part))} if solved.part else {}),
        **(
            {"constraints": plain([dataclasses.asdict(rule) for rule in solved.constraints])}
            if solved.constraints
            else {}
        ),
        "held_cost": about["summary"]["held_cost"],
        "cameras": plain([dataclasses.asdict(change) for change in camera_changes(solved)]),
        **({"sensors": _sensors(solved)} if problem.num_frames else {}),
        "worst_images": plain([dataclasses.asdict(image) for image in solved.worst_images]),
        **place,
        "wall_time": plain(dataclasses.asdict(wall)),
        "output": output,
    }


def _sensors(solved: Result) -> Any:
    return plain([dataclasses.asdict(change) for change in sensor_changes(solved)])


def conversion(
    path: str,
    problem: Problem,
    output: dict[str, str],
    lost: tuple[str, ...],
    edits: CameraEdits | None = None,
) -> dict[str, Any]:
    """Return the report of `bundle convert`."""
    return {
        **heading("convert", path, problem),
        **camera_edits(edits),
        "output": output,
        "lost": list(lost),
    }


def camera_edits(edits: CameraEdits | None) -> dict[str, Any]:
    """Return the part on cameras that were changed before anything else, if they were."""
    return {} if edits is None else {"camera_edits": plain(edits.asdict())}


def information(path: str, problem: Problem, description: Description) -> dict[str, Any]:
    """Return the report of `bundle info`."""
    return {**heading("info", path, problem), **plain(dataclasses.asdict(description))}


def dumps(report: dict[str, Any]) -> str:
    """Return a report as text: ASCII, indented, ending in a newline."""
    return json.dumps(report, indent=2, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Return value in JSON's own types: NumPy scalars, arrays and tuples unwrapped, NaN as None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


def records(columns: Mapping[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """Return arrays of equal length by name as one dictionary an entry."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def solve_options(options: SolveOptions) -> dict[str, Any]:
    """Return every option by name, enumerations in upper case."""
    values = options.asdict()
    for field in dataclasses.fields(options):
        if field.metadata["choices"] is not None:
            values[field.name] = values[field.name].upper()
    return values
