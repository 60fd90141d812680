"""Lenses and the scene: functions of a Matplotlib axis, as on the page of ``bundle report``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bundle.base.arguments import check_type
from bundle.errors import InputError
from bundle.figures.lens_curves import LensCurve
from bundle.figures.matplotlib.charts import COLOURS
from bundle.figures.scene_view import SceneView

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_lens_curves", "draw_scene"]


def draw_lens_curves(ax: Axes, curves: Sequence[LensCurve]) -> None:
    """Draw distortion against the distance from the principal point, and the observed radius.

    Args:
        ax: where.
        curves: of cameras, from ``bundle.figures.lens_curve``; one with a sigma has a band.
    """
    for index, curve in enumerate(curves):
        check_type("curves", curve, LensCurve)
        colour = COLOURS[index % len(COLOURS)]
        label = f"camera {curve.camera_id}"
        ax.plot(curve.radius, curve.distortion, color=colour, label=label)
        if len(curve.sigma):
            low, high = curve.distortion - curve.sigma, curve.distortion + curve.sigma
            ax.fill_between(curve.radius, low, high, color=colour, alpha=0.25, linewidth=0)
        if np.isfinite(curve.observed_radius):
            ax.axvline(curve.observed_radius, color=colour, linestyle=":", linewidth=1)
    ax.set(xlabel="distance from the principal point [px]", ylabel="distortion [px]")
    if curves:
        ax.legend(fontsize=7, title="dotted: observed", title_fontsize=7)


def draw_scene(ax: Axes, view: SceneView) -> None:
    """Draw points and camera centres on an axis with ``projection="3d"``, in the world's frame.

    Raises:
        InputError: the axis is a flat one.
    """
    check_type("view", view, SceneView)
    if ax.name != "3d":
        raise InputError(f'ax: expected an axis with projection="3d", found {ax.name!r}')
    points = view.origin + view.unit * view.points
    centers = view.origin + view.unit * view.centers
    ax.scatter(*points.T, s=0.5, color=COLOURS[0], linewidths=0)  # type: ignore[misc]
    ax.scatter(*centers.T, s=8, color=COLOURS[1], marker="^")  # type: ignore[misc]
    ax.set(xlabel="x", ylabel="y", zlabel="z")
    ax.set_aspect("equal")
