"""How well cameras project: functions of a Matplotlib axis, as on the page of ``bundle report``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bundle.base.arguments import check_type
from bundle.figures.matplotlib.charts import COLOURS
from bundle.figures.projection_uncertainty import ProjectionUncertainty, contour_levels
from bundle.interface.option_fields import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_projection_uncertainty", "draw_uncertainty_against_distance"]


def draw_projection_uncertainty(
    ax: Axes, known: ProjectionUncertainty, distance: float | None = None
) -> None:
    """Draw the uncertainty of a projection over the image, with contours.

    Args:
        ax: where.
        known: of a camera, from ``bundle.figures.projection_uncertainty``.
        distance: of the points [length unit]; None: at infinity.
    """
    check_type("known", known, ProjectionUncertainty)
    at = np.inf if distance is None else number("distance", distance, above=0)
    sigma = known.sigma(at)
    left, top, right, bottom = known.box
    image = ax.imshow(sigma, extent=(left, right, bottom, top), cmap="Blues", vmin=0)
    ax.figure.colorbar(image, ax=ax, label="uncertainty [px]", shrink=0.8)
    levels = contour_levels(sigma)
    if levels and min(sigma.shape) > 1:
        rows, columns = sigma.shape
        x = left + (np.arange(columns) + 0.5) * (right - left) / columns
        y = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
        lines = ax.contour(x, y, sigma, levels, colors="black", linewidths=0.7)
        ax.clabel(lines, fontsize=7)
    where = "at infinity" if distance is None else f"at a distance of {at:g}"
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    ax.set(xlabel="x [px]", ylabel="y [px]", title=f"camera {known.camera_id}, {where}")


def draw_uncertainty_against_distance(ax: Axes, known: ProjectionUncertainty) -> None:
    """Draw the uncertainty of a projection against the distance, the median distance dotted."""
    check_type("known", known, ProjectionUncertainty)
    for index, (name, values) in enumerate(known.by_distance().items()):
        ax.plot(known.distances, values, label=name, color=COLOURS[index])
    ax.axvline(known.distance, color=COLOURS[6], linestyle=":", linewidth=1)
    ax.set(xscale="log", xlabel="distance from the camera", ylabel="uncertainty [px]")
    ax.set_ylim(bottom=0)
    ax.legend(fontsize=7, title=f"camera {known.camera_id}", title_fontsize=7)
