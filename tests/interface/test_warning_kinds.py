"""Kinds of warnings: the names of C++ and Python, and that each sentence has one."""

from __future__ import annotations

import re
from pathlib import Path

import bundle
from bundle.interface.warning_kinds import WARNING_KINDS
from tests import scenes

CORE = Path(__file__).parents[2] / "cpp" / "core"
DECLARED = re.findall(
    r'\{"(\w+)", WarningKind::(\w+)\}', (CORE / "interface/summary.h").read_text()
)


IN_PYTHON = [
    "readout_outside",
    *("weak_baseline", "several_components", "local_minimum", "better_start"),
    *("unproven_set", "one_process", "wrong_factor", "free_directions", "prior_spectrum"),
    "no_tracks",
    "ordering",
    "most_left_out",
]
"""Kinds that the core does not know, after its own."""


def test_names_agree() -> None:
    assert [name for name, _ in DECLARED] + IN_PYTHON == list(WARNING_KINDS)
    assert all(kind == "k" + name.title().replace("_", "") for name, kind in DECLARED)


def test_every_kind_is_given_somewhere() -> None:
    sources = "".join(path.read_text() for path in CORE.rglob("*.cpp"))
    assert {kind for _, kind in DECLARED} == set(re.findall(r"WarningKind::(\w+)", sources))


def test_every_sentence_has_its_kind() -> None:
    problem = scenes.make_problem()
    points = problem.points.copy()
    points[3] *= 1e7
    problem = problem.replace(points=points)
    summary = bundle.solve(
        problem,
        linear_solver_type="dense_schur",
        preconditioner_type="jacobi",
        max_num_iterations=0,
    ).summary
    assert {"far_points", "preconditioner_not_used"} <= set(summary.warning_kinds)
    assert len(summary.warnings) == len(summary.warning_kinds)
    assert len(set(summary.warning_kinds)) == len(summary.warning_kinds)
    assert set(summary.warning_kinds) <= set(WARNING_KINDS)
    for sentence, kind in zip(summary.warnings, summary.warning_kinds, strict=True):
        if kind == "preconditioner_not_used":
            assert "DENSE_SCHUR" in sentence
        if kind == "far_points":
            assert f"point {problem.point_ids[3]}" in sentence
