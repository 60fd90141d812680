"""Reports of `bundle convert`, with the data that are lost, and of `bundle report`."""

from __future__ import annotations

from collections.abc import Sequence as Sentences
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.base.words import format_size
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.model.sequence.sequence import Sequence
from bundle.model.unobserved import unobserved
from bundle.reports.sections import Report, Section
from bundle.reports.terminal.camera_tables import edit_data, edit_rows, shutter_data, shutter_moves
from bundle.reports.terminal.inputs import (
    about_input,
    about_sequence,
    contents_of,
    contents_of_sequence,
    import_notes,
    input_facts,
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
    given: Problem | PoseGraph,
    output: dict[str, str],
    lost: Sentences[str],
    edits: CameraEdits | None = None,
    moved: GlobalShutterModel | None = None,
) -> Report:
    """Return the report on a reconstruction or a pose graph."""
    content = given if edits is None else edits.problem
    warnings = [] if edits is None else [*edits.warnings]
    notes, more = [], edit_rows(edits)
    if isinstance(content, Problem):
        warnings += filter(None, [unobserved(content)])
    if isinstance(given, Problem):
        notes = import_notes(given)
    else:
        more = [("", note) for note in given.notes]
    rest = "These data are lost:" if lost else "Nothing is lost."
    return Report(
        command="convert",
        input=about_input(path, given),
        headline=[
            f"Wrote {written(output)[1]}: {contents_of(content)}. {rest}",
            *shutter_moves(moved),
        ],
        warnings=warnings,
        sections=[
            Section(facts=edit_rows(edits), notes=[*lost, *notes]),
            Section(facts=[*input_facts(path, given), *more], is_detail=True),
        ],
        data={**edit_data(edits), **shutter_data(moved), "output": output, "lost": lost},
    )


def reported(
    path: str,
    given: Problem | PoseGraph,
    page: str,
    notes: Sentences[str],
    wall_time: float,
    findings: Sentences[Finding] = (),
) -> Report:
    """Return the report of `bundle report` about the page that it wrote.

    Args:
        path: path of the input.
        given: problem or graph on the page.
        page: path of the page.
        notes: sentences about missing parts of the page.
        wall_time: seconds.
        findings: findings about the input.
    """
    size = f" ({format_size(Path(page).stat().st_size)})" if Path(page).is_file() else ""
    return Report(
        command="report",
        input=about_input(path, given),
        headline=[f"Wrote {shown(page)}{size}: {contents_of(given)}."],
        warnings=notes,
        findings=findings,
        sections=[Section(facts=input_facts(path, given, rigs=True), is_detail=True)],
        data={
            "notes": notes,
            "wall_time": {"total": wall_time},
            "output": {"path": page, "format": "html"},
        },
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
