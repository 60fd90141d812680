"""Report of `bundle convert`: the input, the output, and the data that are lost."""

from __future__ import annotations

from collections.abc import Sequence as Sentences

from bundle.editing.cameras.edit_record import CameraEdits
from bundle.errors import shown
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.sequence.sequence import Sequence
from bundle.reports.sections import Report, Section
from bundle.reports.terminal.camera_edit_rows import edit_data, edit_rows
from bundle.reports.terminal.inputs import (
    about_graph,
    about_problem,
    about_sequence,
    contents_of_sequence,
    graph_facts,
    problem_facts,
    written,
)

__all__ = ["converted", "converted_graph", "converted_sequence"]


def converted(
    path: str,
    problem: Problem,
    output: dict[str, str],
    lost: Sentences[str],
    edits: CameraEdits | None = None,
) -> Report:
    """Return the report on a reconstruction."""
    facts = [*problem_facts(path, problem), *edit_rows(edits), written(output)]
    warnings = () if edits is None else edits.warnings
    return Report(
        command="convert",
        input=about_problem(path, problem),
        sections=[
            Section(facts=[*facts, ("lost", "" if lost else "nothing")], notes=lost),
            Section(notes=warnings, is_warning=True, is_joined=True),
        ],
        data={**edit_data(edits), "output": output, "lost": lost},
    )


def converted_graph(
    path: str, graph: PoseGraph, output: dict[str, str], lost: Sentences[str]
) -> Report:
    """Return the report on a pose graph."""
    facts = [
        *graph_facts(path, graph),
        *(("", note) for note in graph.notes),
        written(output),
        ("lost", "nothing"),
    ]
    return Report(
        command="convert",
        input=about_graph(path, graph),
        sections=[Section(facts=facts)],
        data={"output": output, "lost": lost},
    )


def converted_sequence(path: str, format: str, sequence: Sequence, output: str) -> Report:
    """Return the report on a visual-inertial sequence."""
    facts = [
        ("input", shown(path)),
        ("", contents_of_sequence(sequence)),
        ("output", f"{shown(output)} (visual-inertial sequence)"),
        ("lost", "nothing"),
    ]
    return Report(
        command="convert",
        input=about_sequence(path, format, sequence),
        sections=[Section(facts=facts)],
        data={"output": {"path": output, "format": "sequence"}, "lost": []},
    )
