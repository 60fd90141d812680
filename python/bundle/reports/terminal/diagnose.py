"""What `bundle diagnose` says."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

from rich.console import RenderableType

from bundle.analysis.diagnosis.diagnosis_result import Diagnosis
from bundle.base.tables import columns, facts, format_name, notes
from bundle.base.words import contents, number, plural
from bundle.errors import shown
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.reports.terminal import json
from bundle.reports.terminal.rig_tables import rig_fact

__all__ = ["as_json", "diagnosed"]

MOST_EIGENVALUES = 4


def diagnosed(path: str, problem: Problem, diagnosis: Diagnosis) -> list[RenderableType]:
    """Return a diagnosis as facts and sentences."""
    problems = [entry.sentence for entry in diagnosis.findings if entry.is_problem]
    others = [entry.sentence for entry in diagnosis.findings if not entry.is_problem]
    return [
        facts(
            [
                ("input", f"{shown(path)} ({format_name(problem.format)})"),
                ("", contents(problem)),
                *rig_fact(problem),
                ("rank", diagnosis.verdict),
                ("eigenvalues", _eigenvalues(diagnosis)),
                ("pieces", _pieces(diagnosis)),
            ]
        ),
        "",
        columns(
            ("reduced camera system", "condition number", "digits: normal equations", "digits: QR"),
            [
                ("as it is", number(diagnosis.condition_number_unscaled), "", ""),
                (
                    "scaled",
                    number(diagnosis.condition_number),
                    str(diagnosis.digits_normal_equations),
                    str(diagnosis.digits_square_root),
                ),
            ],
        ),
        "",
        facts([("problems", "" if problems else "none found")]),
        *notes(problems, style="yellow"),
        *([facts([("notes", "")]), *notes(others)] if others else []),
    ]


def as_json(
    path: str,
    problem: Problem,
    diagnosis: Diagnosis,
    options: SolveOptions,
    names: Iterable[str],
    more_options: dict[str, Any],
    wall_time: float,
) -> dict[str, Any]:
    """Return the report of `bundle diagnose` for programs.

    Args:
        path: of the input.
        problem: what was diagnosed.
        diagnosis: what was found.
        options: with which.
        names: of the options that count.
        more_options: beside these.
        wall_time: seconds.
    """
    numbers = {
        field.name: getattr(diagnosis, field.name) for field in dataclasses.fields(diagnosis)
    }
    for name in ("components", "weak_modes", "collapsed", "findings"):
        numbers[name] = [dataclasses.asdict(entry) for entry in numbers[name]]
    return {
        **json.heading("diagnose", path, problem),
        "options": json.plain({name: getattr(options, name) for name in names} | more_options),
        "ok": diagnosis.ok,
        **json.plain(numbers | {"rank_gap": diagnosis.rank_gap}),
        "digits": {
            "normal_equations": diagnosis.digits_normal_equations,
            "square_root": diagnosis.digits_square_root,
        },
        "wall_time": {"total": wall_time},
    }


def _eigenvalues(diagnosis: Diagnosis) -> str:
    """Return the low end of the spectrum."""
    if not len(diagnosis.eigenvalues):
        return "-"
    lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues[:MOST_EIGENVALUES])
    null = f"zeros up to {diagnosis.max_null_eigenvalue:.1g}, then " if diagnosis.nullity else ""
    return f"{null}{lowest}, ... (scaled reduced camera system)"


def _pieces(diagnosis: Diagnosis) -> str:
    sizes = [len(component.image_ids) for component in diagnosis.components]
    listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
    images = "image" if sizes == [1] else "images"
    return f"{plural(len(sizes), 'connected component')} ({listed} {images})" if sizes else "none"
