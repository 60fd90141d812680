"""What `bundle diagnose` and `bundle covariance` say of a pose graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import RenderableType

from bundle.analysis.diagnosis.graph_diagnosis import GraphDiagnosis
from bundle.analysis.uncertainty.graph_covariance import GraphCovariance
from bundle.base.tables import columns, facts, notes
from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.terminal.covariance import sigmas
from bundle.reports.terminal.json import plain
from bundle.reports.terminal.pose_graph_json import heading_of_graph
from bundle.reports.terminal.pose_graph_tables import contents_of_graph

__all__ = ["certainty_of_graph", "covariance_of_graph", "diagnosed_graph", "diagnosis_of_graph"]

MOST_EDGES = 10
"""Suspicious edges that are shown."""


def diagnosed_graph(path: str, graph: PoseGraph, diagnosis: GraphDiagnosis) -> list[RenderableType]:
    """Return a diagnosis as facts, tables and sentences."""
    sizes = [len(part.pose_ids) for part in diagnosis.components]
    listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
    lowest = ", ".join(f"{value:.3g}" for value in diagnosis.eigenvalues)
    problems = [entry.sentence for entry in diagnosis.findings if entry.is_problem]
    others = [entry.sentence for entry in diagnosis.findings if not entry.is_problem]
    digits = (str(diagnosis.digits_normal_equations), str(diagnosis.digits_square_root))
    return [
        facts(
            [
                ("input", f"{shown(path)} (g2o)"),
                ("", contents_of_graph(graph)),
                ("rank", diagnosis.verdict),
                ("eigenvalues", f"{lowest}, ... (scaled normal equations)" if lowest else "-"),
                (
                    "pieces",
                    f"{plural(len(sizes), 'connected component')} "
                    f"({listed} {'pose' if sizes == [1] else 'poses'})",
                ),
            ]
        ),
        "",
        columns(
            ("normal equations", "condition number", "digits: normal equations", "digits: QR"),
            [
                ("as they are", number(diagnosis.condition_number_unscaled), "", ""),
                ("scaled", number(diagnosis.condition_number), *digits),
            ],
        ),
        "",
        *_suspicious(diagnosis),
        facts([("problems", "" if problems else "none found")]),
        *notes(problems, style="yellow"),
        *([facts([("notes", "")]), *notes(others)] if others else []),
    ]


def _suspicious(diagnosis: GraphDiagnosis) -> list[RenderableType]:
    rows = [
        (
            f"{one.edge[0]} {one.edge[1]}",
            str(one.line or "-"),
            number(one.chi2),
            number(one.test),
            str(one.degrees),
        )
        for one in diagnosis.suspicious_edges[:MOST_EDGES]
    ]
    head = ("suspicious edges", "line", "chi2", "test", "degrees of freedom")
    return [columns(head, rows), ""] if rows else []


def diagnosis_of_graph(
    path: str,
    graph: PoseGraph,
    diagnosis: GraphDiagnosis,
    options: Mapping[str, Any],
    wall: float,
) -> dict[str, Any]:
    """Return the report of `bundle diagnose`; what only reconstructions have is empty."""
    numbers = {
        field.name: getattr(diagnosis, field.name) for field in dataclasses.fields(diagnosis)
    }
    for name in ("components", "weak_modes", "suspicious_edges", "findings"):
        numbers[name] = [dataclasses.asdict(entry) for entry in numbers[name]]
    for mode in numbers["weak_modes"]:
        mode |= {"image_ids": [], "camera_ids": []}
    return {
        **heading_of_graph("diagnose", path, graph),
        "options": plain(dict(options)),
        "ok": diagnosis.ok,
        **plain(numbers),
        "points_without_parallax": [],
        "collapsed": [],
        "digits": {
            "normal_equations": diagnosis.digits_normal_equations,
            "square_root": diagnosis.digits_square_root,
        },
        "wall_time": {"total": wall},
    }


def certainty_of_graph(
    path: str, graph: PoseGraph, cov: GraphCovariance, target: str
) -> list[RenderableType]:
    """Return quantiles of the standard deviations, and what to know of them."""
    sigma = sigmas(cov.pose_covariance)
    parts = ((0, 2), (2, 3)) if graph.dimension == 2 else ((3, 6), (0, 3))
    cells = []
    for name, (first, last) in zip(("translation", "rotation [rad]"), parts, strict=True):
        norms = np.linalg.norm(sigma[:, first:last], axis=1)
        quantiles = np.percentile(norms, [0, 50, 95, 100])
        cells.append((name, f"{len(norms)}", *map(number, quantiles)))
    held = {
        "first": f"{plural(len(cov.held_pose_ids), 'pose')} held, beside fixed ones",
        "inner": "inner constraints: the least trace",
        "none": "by fixed poses",
    }
    rows = [
        ("input", f"{shown(path)} (g2o)"),
        ("", contents_of_graph(graph)),
        ("gauge", f"{cov.gauge}: {held[cov.gauge]}"),
        ("sigma0", f"{number(cov.sigma0)} ({plural(cov.dof, 'degree')} of freedom)"),
        ("scale", "the information of the edges" if cov.scale == "unit" else "times sigma0"),
        ("output", shown(target)),
    ]
    table = columns(("sigma", "count", "min", "median", "95th pct", "max"), cells)
    said = ["", *notes(cov.notes, style="yellow")] if cov.notes else []
    return [facts(rows), "", table, *said]


def covariance_of_graph(
    path: str,
    graph: PoseGraph,
    cov: GraphCovariance,
    options: Mapping[str, Any],
    target: str,
    wall: float,
) -> dict[str, Any]:
    """Return the report of `bundle covariance`; the matrices of poses are in the file."""
    return {
        **heading_of_graph("covariance", path, graph),
        "options": plain(dict(options)),
        "gauge": cov.gauge,
        "held_pose_ids": list(cov.held_pose_ids),
        "scale": cov.scale,
        "robust": "weights",
        **plain({"sigma0": cov.sigma0}),
        "dof": cov.dof,
        "relative": [
            {"ids": plain(pair), "covariance": plain(values)}
            for pair, values in zip(cov.relative_ids, cov.relative_covariance, strict=True)
        ],
        "notes": list(cov.notes),
        "output": {"path": target, "format": "npz"},
        "wall_time": {"total": wall},
    }
