"""Report of `bundle convert`: the input, the output, and the data that are lost."""

from __future__ import annotations

from collections.abc import Sequence as Sentences
from typing import TYPE_CHECKING

from bundle.base.words import contents
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.sequence.sequence import Sequence
from bundle.model.unobserved import unobserved
from bundle.reports.sections import Report, Section
from bundle.reports.terminal.camera_tables import edit_data, edit_rows, shutter_data, shutter_moves
from bundle.reports.terminal.inputs import (
    about_graph,
    about_problem,
    about_sequence,
    contents_of_graph,
    contents_of_sequence,
    graph_facts,
    import_notes,
    problem_facts,
    written,
)
from bundle.reports.terminal.tracking import tracking_headline, tracking_section

if TYPE_CHECKING:
    from bundle.editing.edit_record import CameraEdits
    from bundle.editing.rolling_shutters import GlobalShutterModel
    from bundle.inertial.tracking.track_recording import Tracking
    from bundle.model.sequence.sequence_findings import SequenceFinding


def converted(
    path: str,
    problem: Problem,
    output: dict[str, str],
    lost: Sentences[str],
    edits: CameraEdits | None = None,
    moved: GlobalShutterModel | None = None,
) -> Report:
    """Return the report on a reconstruction."""
    facts = [*problem_facts(path, problem), *edit_rows(edits)]
    content = problem if edits is None else edits.problem
    warnings = [*(() if edits is None else edits.warnings), *filter(None, [unobserved(content)])]
    return Report(
        command="convert",
        input=about_problem(path, problem),
        headline=[_wrote(output, contents(content), lost), *shutter_moves(moved)],
        warnings=warnings,
        sections=[
            Section(facts=edit_rows(edits), notes=[*lost, *import_notes(problem)]),
            Section(facts=facts, is_detail=True),
        ],
        data={**edit_data(edits), **shutter_data(moved), "output": output, "lost": lost},
    )


def _wrote(output: dict[str, str], content: str, lost: Sentences[str]) -> str:
    """Return what was written where, and whether data are lost."""
    _, where = written(output)
    rest = "These data are lost:" if lost else "Nothing is lost."
    return f"Wrote {where}: {content}. {rest}"


def converted_graph(
    path: str, graph: PoseGraph, output: dict[str, str], lost: Sentences[str]
) -> Report:
    """Return the report on a pose graph."""
    facts = [*graph_facts(path, graph), *(("", note) for note in graph.notes)]
    return Report(
        command="convert",
        input=about_graph(path, graph),
        headline=[_wrote(output, contents_of_graph(graph), lost)],
        sections=[Section(notes=lost), Section(facts=facts, is_detail=True)],
        data={"output": output, "lost": lost},
    )


def converted_sequence(
    path: str,
    format: str,
    sequence: Sequence,
    output: str,
    findings: Sentences[SequenceFinding | Finding] = (),
    tracking: Tracking | None = None,
) -> Report:
    """Return the report on a visual-inertial sequence.

    Args:
        path: path of the input.
        format: format of the input.
        sequence: the sequence.
        output: path of the folder.
        findings: suspicious properties of tracked images.
        tracking: statistics of tracking; None if the input has tracks.
    """
    wrote = f"Wrote {shown(output)} (visual-inertial sequence)"
    lost = [] if tracking is None else ["images"]
    rest = "Nothing is lost." if tracking is None else tracking_headline(tracking)
    return Report(
        command="convert",
        input=about_sequence(path, format, sequence),
        headline=[f"{wrote}: {contents_of_sequence(sequence)}. {rest}"],
        warnings=[] if tracking is None else [f"{finding.sentence}." for finding in findings],
        sections=[
            Section(facts=[("input", shown(path))], is_detail=True),
            *([] if tracking is None else [tracking_section(sequence, tracking)]),
        ],
        data={
            "output": {"path": output, "format": "sequence"},
            "lost": lost,
            **({} if tracking is None else {"tracking": tracking, "findings": findings}),
        },
    )
