"""Report of `bundle diagnose` on a reconstruction or on a pose graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bundle.analysis.diagnosis.diagnosis_result import Diagnosis, GraphDiagnosis
from bundle.base.words import number, plural
from bundle.interface.finding import Finding, one_list
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.reports.sections import Column, Report, Section, Table, fields
from bundle.reports.terminal.inputs import about_input, input_facts

MOST_EIGENVALUES = 4
MOST_EDGES = 10
"""Number of suspicious edges shown."""

SUSPICIOUS = (
    Column("suspicious edges", lambda one: f"{one.edge[0]} {one.edge[1]}"),
    Column("line", lambda one: one.line or "-"),
    Column("chi2", "chi2", number),
    Column("test", "test", number),
    Column("degrees of freedom", "degrees"),
)


def diagnosed(
    path: str,
    given: Problem | PoseGraph,
    diagnosis: Diagnosis | GraphDiagnosis,
    options: Mapping[str, Any],
    wall_time: float,
    found: Sequence[Finding] = (),
) -> Report:
    """Return the report on a reconstruction or a pose graph.

    Args:
        path: path of the input.
        given: the diagnosed problem or graph.
        diagnosis: its diagnosis.
        options: options that affect the diagnosis.
        wall_time: seconds.
        found: further findings about the input.
    """
    data = fields(diagnosis)
    suspicious: list[Section] = []
    if isinstance(diagnosis, Diagnosis):
        sizes, noun = [len(part.image_ids) for part in diagnosis.components], "image"
        matrix = ("reduced camera system", "as it is")
        data["rank_gap"] = diagnosis.rank_gap
    else:
        sizes, noun = [len(part.pose_ids) for part in diagnosis.components], "pose"
        matrix = ("normal equations", "as they are")
        no_ids: dict[str, Any] = {"image_ids": [], "camera_ids": []}
        data["weak_modes"] = [fields(mode) | no_ids for mode in diagnosis.weak_modes]
        data |= {"points_without_parallax": [], "collapsed": []}
        rows = diagnosis.suspicious_edges[:MOST_EDGES]
        suspicious = [Section(tables=[Table(SUSPICIOUS, rows)])] if rows else []
    facts = [
        *input_facts(path, given, rigs=True),
        ("rank", diagnosis.verdict),
        ("eigenvalues", _eigenvalues(diagnosis)),
        ("pieces", _pieces(sizes, noun)),
    ]
    problems = [entry for entry in diagnosis.findings if entry.is_problem]
    return Report(
        command="diagnose",
        input=about_input(path, given),
        headline=_headline(diagnosis, sizes, noun),
        findings=one_list(problems, found),
        sections=[
            Section(facts=facts, is_detail=True),
            Section(tables=[_condition(*matrix, diagnosis)], is_detail=True),
            *suspicious,
            *_notes(diagnosis),
        ],
        data={
            "options": dict(options),
            "ok": diagnosis.ok,
            **data,
            "findings": one_list(diagnosis.findings, found),
            "digits": {
                "normal_equations": diagnosis.digits_normal_equations,
                "square_root": diagnosis.digits_square_root,
            },
            "wall_time": {"total": wall_time},
        },
    )


def _condition(title: str, unscaled: str, diagnosis: Diagnosis | GraphDiagnosis) -> Table:
    digits = (str(diagnosis.digits_normal_equations), str(diagnosis.digits_square_root))
    return Table.of(
        (title, "condition number", "digits: normal equations", "digits: QR"),
        [
            (unscaled, number(diagnosis.condition_number_unscaled), "", ""),
            ("scaled", number(diagnosis.condition_number), *digits),
        ],
    )


def _headline(diagnosis: Diagnosis | GraphDiagnosis, sizes: Sequence[int], noun: str) -> list[str]:
    """Return the rank, then the condition number and the connected components."""
    verdict = diagnosis.verdict.rstrip(".")
    held = ""
    if isinstance(diagnosis, GraphDiagnosis) and np.isfinite(diagnosis.condition_number):
        held = diagnosis.held_words
    condition = f"Condition number {number(diagnosis.condition_number)} (scaled{held})"
    return [
        f"{verdict[0].upper()}{verdict[1:]}.",
        f"{condition}; {_pieces(sizes, noun)}{'; no problem found' if diagnosis.ok else ''}.",
    ]


def _notes(diagnosis: Diagnosis | GraphDiagnosis) -> list[Section]:
    others = [entry.sentence for entry in diagnosis.findings if not entry.is_problem]
    return [Section(facts=[("notes", "")], notes=others, is_detail=True)] if others else []


def _eigenvalues(diagnosis: Diagnosis | GraphDiagnosis) -> str:
    """Return the smallest eigenvalues as text."""
    if not len(diagnosis.eigenvalues):
        return "-"
    if isinstance(diagnosis, GraphDiagnosis):
        lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues)
        return f"{lowest}, ... (scaled normal equations)"
    lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues[:MOST_EIGENVALUES])
    null = f"zeros up to {diagnosis.max_null_eigenvalue:.1g}, then " if diagnosis.nullity else ""
    return f"{null}{lowest}, ... (scaled reduced camera system)"


def _pieces(sizes: Sequence[int], noun: str) -> str:
    listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
    members = noun if sizes == [1] else f"{noun}s"
    return f"{plural(len(sizes), 'connected component')} ({listed} {members})" if sizes else "none"
