"""Control points, positions and correlations: functions of a Matplotlib axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bundle.base.arguments import check_type
from bundle.errors import InputError
from bundle.figures.certainty import Certainty
from bundle.figures.matplotlib.charts import COLOURS
from bundle.figures.placement_errors import Placement
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_correlations", "draw_position_errors", "draw_target_errors"]

ROLES = {"control": COLOURS[0], "check": COLOURS[1], "unused": COLOURS[6]}


def draw_target_errors(ax: Axes, place: Placement) -> None:
    """Draw horizontal errors of control and check points, and the ellipses of their survey."""
    check_type("place", place, Placement)
    for target in place.targets:
        if np.isfinite(target.residual[:2]).all():
            east, north = target.residual[:2].tolist()
            ax.plot(east, north, "o", color=ROLES.get(target.role, COLOURS[6]))
            ax.annotate(target.name, (east, north), (4, 4), textcoords="offset points",
                        fontsize=7, parse_math=False)  # fmt: skip
            _ellipse(ax, np.diag(target.sigma[:2] ** 2), COLOURS[2])
    _errors(ax, "control points blue, check points orange")


def draw_position_errors(ax: Axes, place: Placement) -> None:
    """Draw horizontal errors of measured positions, and the ellipse of their mean square."""
    check_type("place", place, Placement)
    residuals = np.array([image.residual[:2] for image in place.images]).reshape(-1, 2)
    residuals = residuals[np.isfinite(residuals).all(axis=1)]
    ax.plot(*residuals.T, ".", color=COLOURS[0])
    if len(residuals):
        _ellipse(ax, residuals.T @ residuals / len(residuals), COLOURS[1])
    _errors(ax, "positions of images")


def draw_correlations(ax: Axes, problem: Problem, known: Certainty, camera: int) -> None:
    """Draw the correlation matrix of the refined parameters of a camera, given by its index.

    Raises:
        InputError: the camera has no covariance.
    """
    check_type("known", known, Certainty)
    if camera not in known.cameras:
        raise InputError(f"camera: expected one of {sorted(known.cameras)}, found {camera}")
    covariance = known.cameras[camera]
    names = camera_models()[problem.camera_models[camera]]
    free = np.flatnonzero(np.diag(covariance)[: len(names)] > 0)
    sigma = np.sqrt(np.diag(covariance)[free])
    matrix = covariance[np.ix_(free, free)] / np.outer(sigma, sigma)
    image = ax.imshow(matrix, cmap="RdBu", vmin=-1, vmax=1)
    labels = [names[index] for index in free]
    ax.set_xticks(range(len(free)), labels)
    ax.set_yticks(range(len(free)), labels)
    ax.figure.colorbar(image, ax=ax, label="correlation", shrink=0.8)
    ax.set_title(f"camera {problem.camera_ids[camera]}")


def _ellipse(ax: Axes, covariance: np.ndarray, colour: str) -> None:
    values, vectors = np.linalg.eigh(covariance)
    around = np.linspace(0, 2 * np.pi, 61)
    unit = np.stack([np.cos(around), np.sin(around)])
    ax.plot(*(vectors @ (np.sqrt(np.maximum(values, 0))[:, None] * unit)), color=colour)


def _errors(ax: Axes, title: str) -> None:
    ax.set(xlabel="error east [m]", ylabel="error north [m]", title=title)
    ax.set_aspect("equal", adjustable="datalim")
