"""Report of `bundle covariance` on a reconstruction or on a pose graph.

It contains only sigmas; the command writes the matrices to a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_result import Covariance, GraphCovariance
from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.model.cameras import camera_models
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section, Table
from bundle.reports.terminal.inputs import (
    about_graph,
    about_problem,
    graph_facts,
    problem_facts,
)

MOST_CAMERAS = 10
"""Number of listed cameras."""


def uncertainties(
    path: str,
    problem: Problem,
    cov: Covariance,
    options: Mapping[str, Any],
    target: str,
    wall_time: float,
) -> Report:
    """Return the report on a reconstruction.

    Args:
        path: path of the input.
        problem: problem of the covariance.
        cov: computed covariance.
        options: options of the covariance.
        target: path of the file with the matrices.
        wall_time: seconds.
    """
    pose, point = _sigmas(cov.pose_covariance), _sigmas(cov.point_covariance)
    spread = [("rotation [rad]", pose[:, :3]), ("translation", pose[:, 3:]), ("point", point)]
    cameras = zip(cov.camera_ids, _sigmas(cov.camera_covariance), strict=True)
    facts = [
        *problem_facts(path, problem),
        ("gauge", cov.gauge.replace("_", " ")),
        _sigma0(cov),
        ("scale", _scale(cov)),
    ]
    return Report(
        command="covariance",
        input=about_problem(path, problem),
        headline=[_sigmas_in_words(spread, "of the model"), _certainty(cov)],
        warnings=_notes(cov),
        sections=[
            Section(facts=[("output", shown(target))]),
            Section(facts=facts, is_detail=True),
            *_spread(spread),
            *_cameras(problem, cov),
        ],
        data={
            "options": dict(options),
            "gauge": cov.gauge,
            "scale": cov.scale,
            "robust": cov.robust,
            "sigma0": cov.sigma0,
            "dof": cov.dof,
            "cameras": [
                {"id": int(key), "model": problem.camera_models[row], "sigma": sigma}
                for row, (key, sigma) in enumerate(cameras)
            ],
            "relative": _relative(cov),
            "points_without_parallax": cov.null_point_ids,
            "notes": cov.notes,
            "output": {"path": target, "format": "npz"},
            "wall_time": {"total": wall_time},
        },
    )


def uncertainties_of_graph(
    path: str,
    graph: PoseGraph,
    cov: GraphCovariance,
    options: Mapping[str, Any],
    target: str,
    wall_time: float,
) -> Report:
    """Return the report on a pose graph; arguments as in :func:`uncertainties`."""
    sigma = _sigmas(cov.pose_covariance)
    parts = ((0, 2), (2, 3)) if graph.dimension == 2 else ((3, 6), (0, 3))
    names = ("translation", "rotation [rad]")
    spread = [
        (name, sigma[:, first:last]) for name, (first, last) in zip(names, parts, strict=True)
    ]
    held = {
        "first": f"{plural(len(cov.held_pose_ids), 'pose')} constant, besides fixed ones",
        "inner": "inner constraints (minimum trace)",
        "none": "by fixed poses",
    }
    facts = [
        *graph_facts(path, graph),
        ("gauge", f"{cov.gauge}: {held[cov.gauge]}"),
        _sigma0(cov),
        ("scale", "the information of the edges" if cov.scale == "unit" else "times sigma0"),
    ]
    return Report(
        command="covariance",
        input=about_graph(path, graph),
        headline=[_sigmas_in_words(spread, "of the graph"), _certainty(cov)],
        warnings=cov.notes,
        sections=[
            Section(facts=[("output", shown(target))]),
            Section(facts=facts, is_detail=True),
            *_spread(spread),
        ],
        data={
            "options": dict(options),
            "gauge": cov.gauge,
            "held_pose_ids": cov.held_pose_ids,
            "scale": cov.scale,
            "robust": "weights",
            "sigma0": cov.sigma0,
            "dof": cov.dof,
            "relative": _relative(cov),
            "notes": cov.notes,
            "output": {"path": target, "format": "npz"},
            "wall_time": {"total": wall_time},
        },
    )


def _sigma0(cov: Covariance | GraphCovariance) -> tuple[str, str]:
    return "sigma0", f"{number(cov.sigma0)} ({plural(cov.dof, 'degree')} of freedom)"


def _certainty(cov: Covariance | GraphCovariance) -> str:
    """Return sigma0 and the gauge in a sentence."""
    gauge = cov.gauge.replace("_", " ")
    return f"sigma0 {number(cov.sigma0)} ({plural(cov.dof, 'degree')} of freedom); gauge {gauge}."


def _sigmas_in_words(parts: Sequence[tuple[str, NDArray[np.float64]]], unit: str) -> str:
    """Return the median and the 95th percentile of each standard deviation in a sentence."""
    said = []
    for name, values in _lengths(parts):
        median, p95 = map(number, np.percentile(values, [50, 95]))
        said.append(f"{name} {median} / {p95}")
    if not said:
        return "No variable is free: there is no standard deviation."
    return f"Sigma (median / 95th percentile, length unit {unit}): {', '.join(said)}."


def _scale(cov: Covariance) -> str:
    if cov.robust == "sandwich":
        return "sandwich, from the scatter of the residuals"
    return "residual sigma of 1 px, or as given" if cov.scale == "unit" else "times sigma0"


def _relative(cov: Covariance | GraphCovariance) -> list[dict[str, Any]]:
    pairs = zip(cov.relative_ids, cov.relative_covariance, strict=True)
    return [{"ids": pair, "covariance": values} for pair, values in pairs]


def _spread(parts: Iterable[tuple[str, NDArray[np.float64]]]) -> list[Section]:
    """Return quantiles of standard deviations; empty if none is known."""
    cells = []
    for name, values in _lengths(parts):
        quantiles = np.percentile(values, [0, 50, 95, 100])
        cells.append((name, f"{len(values)}", *map(number, quantiles)))
    head = ("sigma", "count", "min", "median", "95th pct", "max")
    return [Section(tables=[Table.of(head, cells)], is_detail=True)] if cells else []


def _lengths(
    parts: Iterable[tuple[str, NDArray[np.float64]]],
) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the known standard deviations of each part, as lengths of their vectors."""
    lengths = [(name, np.linalg.norm(sigma, axis=1)) for name, sigma in parts]
    known = [(name, values[np.isfinite(values)]) for name, values in lengths]
    return [(name, values) for name, values in known if len(values)]


def _cameras(problem: Problem, cov: Covariance) -> list[Section]:
    cells = []
    for row in range(min(len(cov.camera_ids), MOST_CAMERAS)):
        model = problem.camera_models[row]
        sigma = _sigmas(cov.camera_covariance[row])
        for j, name in enumerate(camera_models().get(model, ())):
            value = problem.camera_params[row, j]
            shown_sigma = "held" if np.isnan(sigma[j]) else number(float(sigma[j]))
            label = f"{cov.camera_ids[row]} {model}" if j == 0 else ""
            cells.append((label, name, number(float(value)), shown_sigma))
    if not cells:
        return []
    more = len(cov.camera_ids) - MOST_CAMERAS
    table = Table.of(("camera", "parameter", "value", "sigma"), cells, left=2)
    text = [f"and {plural(more, 'camera')} more"] if more > 0 else []
    return [Section(tables=[table], text=text, is_detail=True)]


def _notes(cov: Covariance) -> list[str]:
    sentences = list(cov.notes)
    null = cov.null_point_ids
    if len(null):
        ids = ", ".join(map(str, null[:8])) + (", ..." if len(null) > 8 else "")
        sentences.append(
            f"{plural(len(null), 'point')} without parallax: the unobservable direction is "
            f"left out (ids {ids})."
        )
    return sentences


def _sigmas(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return standard deviations: square roots of the diagonals."""
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    return np.sqrt(np.maximum(variances, 0))  # NaN stays NaN
