"""What `bundle covariance` says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType

from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.base.tables import columns, facts, format_name, notes, plural
from bundle.base.words import contents, number
from bundle.errors import shown
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.reports.terminal import json

__all__ = ["as_json", "sigmas", "uncertainties"]

MOST_CAMERAS = 10
"""Cameras that are listed."""


def uncertainties(
    path: str, problem: Problem, cov: Covariance, target: str
) -> list[RenderableType]:
    """Return what is in a covariance as tables and sentences."""
    rows = [
        ("input", f"{shown(path)} ({format_name(problem.format)})"),
        ("", contents(problem)),
        ("gauge", cov.gauge.replace("_", " ")),
        ("sigma0", f"{number(cov.sigma0)} ({plural(cov.dof, 'degree')} of freedom)"),
        ("scale", _scale(cov)),
        ("output", shown(target)),
    ]
    return [facts(rows), *_spread(cov), *_cameras(problem, cov), *_notes(cov)]


def _scale(cov: Covariance) -> str:
    if cov.robust == "sandwich":
        return "sandwich: as the residuals scatter"
    return "residuals of 1 px, or of their sigmas" if cov.scale == "unit" else "times sigma0"


def _spread(cov: Covariance) -> list[RenderableType]:
    """Return quantiles of standard deviations."""
    cells = []
    pose, point = sigmas(cov.pose_covariance), sigmas(cov.point_covariance)
    for name, values in (
        ("rotation [rad]", np.linalg.norm(pose[:, :3], axis=1)),
        ("translation", np.linalg.norm(pose[:, 3:], axis=1)),
        ("point", np.linalg.norm(point, axis=1)),
    ):
        known = values[np.isfinite(values)]
        if len(known):
            quantiles = np.percentile(known, [0, 50, 95, 100])
            cells.append((name, f"{len(known)}", *map(number, quantiles)))
    if not cells:
        return []
    return ["", columns(("sigma", "count", "min", "median", "95th pct", "max"), cells)]


def _cameras(problem: Problem, cov: Covariance) -> list[RenderableType]:
    cells = []
    for row in range(min(len(cov.camera_ids), MOST_CAMERAS)):
        model = problem.camera_models[row]
        sigma = sigmas(cov.camera_covariance[row])
        for j, name in enumerate(camera_models().get(model, ())):
            value = problem.camera_params[row, j]
            shown_sigma = "held" if np.isnan(sigma[j]) else number(float(sigma[j]))
            label = f"{cov.camera_ids[row]} {model}" if j == 0 else ""
            cells.append((label, name, number(float(value)), shown_sigma))
    if not cells:
        return []
    more = len(cov.camera_ids) - MOST_CAMERAS
    table = columns(("camera", "parameter", "value", "sigma"), cells, left=2)
    return ["", table, *([f"and {plural(more, 'camera')} more"] if more > 0 else [])]


def _notes(cov: Covariance) -> list[RenderableType]:
    sentences = list(cov.notes)
    null = cov.null_point_ids
    if len(null):
        ids = ", ".join(map(str, null[:8])) + (", ..." if len(null) > 8 else "")
        sentences.append(
            f"{plural(len(null), 'point')} without parallax: left out along the direction that "
            f"nothing sees (ids {ids})."
        )
    return ["", *notes(sentences, style="yellow")] if sentences else []


def sigmas(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the roots of the diagonals."""
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    return np.sqrt(np.maximum(variances, 0))  # NaN stays NaN


def as_json(
    path: str,
    problem: Problem,
    cov: Covariance,
    options: Mapping[str, Any],
    target: str,
    wall: float,
) -> dict[str, Any]:
    """Return the report of `bundle covariance`; sigmas alone, as the matrices are in the file."""
    return {
        **json.heading("covariance", path, problem),
        "options": json.plain(dict(options)),
        "gauge": cov.gauge,
        "scale": cov.scale,
        "robust": cov.robust,
        "sigma0": cov.sigma0,
        "dof": cov.dof,
        "cameras": [
            {"id": int(key), "model": problem.camera_models[row], "sigma": json.plain(sigma)}
            for row, (key, sigma) in enumerate(
                zip(cov.camera_ids, sigmas(cov.camera_covariance), strict=True)
            )
        ],
        "relative": [
            {"ids": json.plain(pair), "covariance": json.plain(values)}
            for pair, values in zip(cov.relative_ids, cov.relative_covariance, strict=True)
        ],
        "points_without_parallax": json.plain(cov.null_point_ids),
        "notes": list(cov.notes),
        "output": {"path": target, "format": "npz"},
        "wall_time": {"total": wall},
    }
