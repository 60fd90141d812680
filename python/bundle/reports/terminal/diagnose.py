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
from bundle.reports.terminal.inputs import (
    about_graph,
    about_problem,
    graph_facts,
    problem_facts,
)

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
    problem: Problem,
    diagnosis: Diagnosis,
    options: Mapping[str, Any],
    wall_time: float,
    found: Sequence[Finding] = (),
) -> Report:
    """Return the report on a reconstruction.

    Args:
        path: path of the input.
        problem: the diagnosed problem.
        diagnosis: its diagnosis.
        options: options that affect the diagnosis.
        wall_time: seconds.
        found: further findings about the problem.
    """
    sizes = [len(component.image_ids) for component in diagnosis.components]
    facts = [
        *problem_facts(path, problem, rigs=True),
        ("rank", diagnosis.verdict),
        ("eigenvalues", _eigenvalues(diagnosis)),
        ("pieces", _pieces(sizes, "image")),
    ]
    numbers = {
        **fields(diagnosis),
        "rank_gap": diagnosis.rank_gap,
    }
    return Report(
        command="diagnose",
        input=about_problem(path, problem),
        headline=_headline(diagnosis, sizes, "image"),
        findings=one_list(_problems(diagnosis), found),
        sections=[
            Section(facts=facts, is_detail=True),
            Section(
                tables=[_condition("reduced camera system", "as it is", diagnosis)], is_detail=True
            ),
            *_notes(diagnosis),
        ],
        data=_data(diagnosis, options, numbers, wall_time)
        | {"findings": one_list(diagnosis.findings, found)},
    )


def diagnosed_graph(
    path: str,
    graph: PoseGraph,
    diagnosis: GraphDiagnosis,
    options: Mapping[str, Any],
    wall_time: float,
) -> Report:
    """Return the report on a pose graph; data that only reconstructions have are empty."""
    sizes = [len(part.pose_ids) for part in diagnosis.components]
    lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues)
    facts = [
        *graph_facts(path, graph),
        ("rank", diagnosis.verdict),
        ("eigenvalues", f"{lowest}, ... (scaled normal equations)" if lowest else "-"),
        ("pieces", _pieces(sizes, "pose")),
    ]
    suspicious = Table(SUSPICIOUS, diagnosis.suspicious_edges[:MOST_EDGES])
    modes = [fields(mode) | {"image_ids": [], "camera_ids": []} for mode in diagnosis.weak_modes]
    numbers = {
        **(fields(diagnosis) | {"weak_modes": modes}),
        "points_without_parallax": [],
        "collapsed": [],
    }
    return Report(
        command="diagnose",
        input=about_graph(path, graph),
        headline=_headline(diagnosis, sizes, "pose"),
        findings=_problems(diagnosis),
        sections=[
            Section(facts=facts, is_detail=True),
            Section(
                tables=[_condition("normal equations", "as they are", diagnosis)], is_detail=True
            ),
            *([Section(tables=[suspicious])] if suspicious.rows else []),
            *_notes(diagnosis),
        ],
        data=_data(diagnosis, options, numbers, wall_time),
    )


def _data(
    diagnosis: Diagnosis | GraphDiagnosis,
    options: Mapping[str, Any],
    numbers: dict[str, Any],
    wall_time: float,
) -> dict[str, Any]:
    return {
        "options": dict(options),
        "ok": diagnosis.ok,
        **numbers,
        "digits": {
            "normal_equations": diagnosis.digits_normal_equations,
            "square_root": diagnosis.digits_square_root,
        },
        "wall_time": {"total": wall_time},
    }


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


def _problems(diagnosis: Diagnosis | GraphDiagnosis) -> list[Finding]:
    return [entry for entry in diagnosis.findings if entry.is_problem]


def _notes(diagnosis: Diagnosis | GraphDiagnosis) -> list[Section]:
    others = [entry.sentence for entry in diagnosis.findings if not entry.is_problem]
    return [Section(facts=[("notes", "")], notes=others, is_detail=True)] if others else []


def _eigenvalues(diagnosis: Diagnosis) -> str:
    """Return the smallest eigenvalues as text."""
    if not len(diagnosis.eigenvalues):
        return "-"
    lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues[:MOST_EIGENVALUES])
    null = f"zeros up to {diagnosis.max_null_eigenvalue:.1g}, then " if diagnosis.nullity else ""
    return f"{null}{lowest}, ... (scaled reduced camera system)"


def _pieces(sizes: Sequence[int], noun: str) -> str:
    listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
    members = noun if sizes == [1] else f"{noun}s"
    return f"{plural(len(sizes), 'connected component')} ({listed} {members})" if sizes else "none"
