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
from bundle.reports.terminal.inputs import about_input, input_facts

MOST_CAMERAS = 10
"""Number of listed cameras."""


def uncertainties(
    path: str,
    given: Problem | PoseGraph,
    cov: Covariance | GraphCovariance,
    options: Mapping[str, Any],
    target: str,
    wall_time: float,
) -> Report:
    """Return the report on a reconstruction or a pose graph.

    Args:
        path: path of the input.
        given: problem or graph of the covariance.
        cov: computed covariance.
        options: options of the covariance.
        target: path of the file with the matrices.
        wall_time: seconds.
    """
    pose = _sigmas(cov.pose_covariance)
    cameras: list[Section] = []
    data: dict[str, Any] = {"gauge": cov.gauge}
    if isinstance(cov, Covariance) and isinstance(given, Problem):
        spread = [("rotation [rad]", pose[:, :3]), ("translation", pose[:, 3:])]
        spread.append(("point", _sigmas(cov.point_covariance)))
        gauge, whole, warnings = cov.gauge.replace("_", " "), "of the model", _notes(cov)
        cameras = _cameras(given, cov)
        sigmas = zip(cov.camera_ids, _sigmas(cov.camera_covariance), strict=True)
        data["robust"] = cov.robust
        data["cameras"] = [
            {"id": int(key), "model": given.camera_models[row], "sigma": sigma}
            for row, (key, sigma) in enumerate(sigmas)
        ]
        data["points_without_parallax"] = cov.null_point_ids
    else:
        assert isinstance(cov, GraphCovariance)
        parts = [pose[:, :2], pose[:, 2:]] if pose.shape[1] == 3 else [pose[:, 3:], pose[:, :3]]
        spread = [*zip(("translation", "rotation [rad]"), parts, strict=True)]
        gauge, whole, warnings = _held(cov), "of the graph", [*cov.notes]
        data |= {"held_pose_ids": cov.held_pose_ids, "robust": "weights"}
    facts = [*input_facts(path, given), ("gauge", gauge), _sigma0(cov), ("scale", _scale(cov))]
    pairs = zip(cov.relative_ids, cov.relative_covariance, strict=True)
    return Report(
        command="covariance",
        input=about_input(path, given),
        headline=[_sigmas_in_words(spread, whole), _certainty(cov)],
        warnings=warnings,
        sections=[
            Section(facts=[("output", shown(target))]),
            Section(facts=facts, is_detail=True),
            *_spread(spread),
            *cameras,
        ],
        data={
            "options": dict(options),
            **data,
            "scale": cov.scale,
            "sigma0": cov.sigma0,
            "dof": cov.dof,
            "relative": [{"ids": ids, "covariance": values} for ids, values in pairs],
            "notes": cov.notes,
            "output": {"path": target, "format": "npz"},
            "wall_time": {"total": wall_time},
        },
    )


def _held(cov: GraphCovariance) -> str:
    """Return the gauge of a graph with the poses that it holds."""
    held = {
        "first": f"{plural(len(cov.held_pose_ids), 'pose')} constant, besides fixed ones",
        "inner": "inner constraints (minimum trace)",
        "none": "by fixed poses",
    }
    return f"{cov.gauge}: {held[cov.gauge]}"


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


def _scale(cov: Covariance | GraphCovariance) -> str:
    if cov.scale != "unit" and (isinstance(cov, GraphCovariance) or cov.robust != "sandwich"):
        return "times sigma0"
    if isinstance(cov, GraphCovariance):
        return "the information of the edges"
    if cov.robust == "sandwich":
        return "sandwich, from the scatter of the residuals"
    return "residual sigma of 1 px, or as given"


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
