"""What residuals show: functions of a Matplotlib axis, as on the page of ``bundle report``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.arguments import check_type
from bundle.figures.image_residuals import ImageResiduals
from bundle.figures.matplotlib.charts import COLOURS
from bundle.figures.matplotlib.directions import direction_colours
from bundle.figures.residual_field import SIGNIFICANT, ResidualField
from bundle.figures.residual_histogram import ResidualHistogram
from bundle.figures.track_statistics import TrackStatistics
from bundle.interface.option_fields import choice, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "draw_image_residuals",
    "draw_radial_profile",
    "draw_residual_cells",
    "draw_residual_directions",
    "draw_residual_histogram",
    "draw_residual_lengths",
    "draw_residual_vectors",
    "draw_track_lengths",
    "draw_triangulation_angles",
]

CELLS = {
    "count": "observations",
    "rms": "RMSE [px]",
    "significance": "mean [standard errors]",
}


def draw_residual_histogram(ax: Axes, histogram: ResidualHistogram) -> None:
    """Draw coordinates of residuals, each set under its label."""
    check_type("histogram", histogram, ResidualHistogram)
    for index, (label, counts) in enumerate(histogram.coordinates.items()):
        words = f"{label}, sigma {histogram.sigma[label]:.3g} px"
        ax.stairs(counts, histogram.edges, label=words, color=COLOURS[index])
    ax.set(xlabel="residual in x or y [px]", ylabel="count", ylim=(0, None))
    ax.legend(fontsize=7)


def draw_residual_lengths(ax: Axes, histogram: ResidualHistogram) -> None:
    """Draw lengths of residuals on a logarithmic axis, each set under its label."""
    check_type("histogram", histogram, ResidualHistogram)
    for index, (label, counts) in enumerate(histogram.lengths.items()):
        ax.stairs(counts, histogram.length_edges, label=label, color=COLOURS[index])
    ax.set(xscale="log", xlabel="length of the residual [px]", ylabel="count", ylim=(0, None))
    ax.legend(fontsize=7)


def draw_residual_vectors(ax: Axes, field: ResidualField, factor: float | None = None) -> None:
    """Draw the mean residual of each cell, orange where it is significant.

    Args:
        ax: where.
        field: of a camera, from ``bundle.figures.residual_fields``.
        factor: by which lines are longer than residuals; None chooses a round one.
    """
    check_type("field", field, ResidualField)
    factor = field.vector_factor if factor is None else number("factor", factor, above=0)
    x, y = _middles(field)
    filled = field.count > 0
    bold = field.significance[filled] > SIGNIFICANT
    colours = np.where(bold, COLOURS[1], COLOURS[6])
    mean = factor * field.mean[filled]
    ax.quiver(
        x[filled], y[filled], mean[:, 0], mean[:, 1], color=colours, angles="xy",
        scale_units="xy", scale=1, width=0.003, headwidth=0, headlength=0, headaxislength=0,
    )  # fmt: skip
    ax.scatter(x[filled], y[filled], s=1.5, color=COLOURS[6], linewidths=0)
    _plane(ax, field, f"mean residual, x {factor:g}")


def draw_residual_cells(ax: Axes, field: ResidualField, what: str = "significance") -> None:
    """Draw a number of each cell: "count", "rms" [pixels] or "significance" [standard errors]."""
    check_type("field", field, ResidualField)
    what = choice("what", what, tuple(CELLS))
    values = np.where(field.count > 0, getattr(field, what), np.nan).astype(float)
    left, top, right, bottom = field.box
    image = ax.imshow(values, extent=(left, right, bottom, top), cmap="Blues", vmin=0)
    ax.figure.colorbar(image, ax=ax, label=CELLS[what], shrink=0.8)
    _plane(ax, field, {"rms": "magnitude"}.get(what, what))


def draw_residual_directions(ax: Axes, field: ResidualField) -> None:
    """Draw residuals as dots, coloured by direction: clusters of a colour are systematic."""
    check_type("field", field, ResidualField)
    colours = direction_colours(field.dot_residuals) / 255.0
    ax.scatter(field.dots[:, 0], field.dots[:, 1], c=colours, s=2, linewidths=0)
    _plane(ax, field, "directions")


def draw_radial_profile(ax: Axes, field: ResidualField) -> None:
    """Draw mean residuals outwards and across against the distance from the principal point."""
    check_type("field", field, ResidualField)
    profile = field.profile
    for index, (name, mean, error) in enumerate(
        (
            ("outwards", profile.radial, profile.radial_error),
            ("across", profile.tangential, profile.tangential_error),
        )
    ):
        bars = np.where(np.isfinite(error), error, 0.0)
        ax.errorbar(profile.radius, mean, bars, label=name, color=COLOURS[index], fmt=".-")
    ax.axhline(0.0, color="0.7", linewidth=0.8)
    ax.set(xlabel="distance from the principal point [px]", ylabel="mean residual [px]")
    ax.legend(fontsize=7)


def draw_image_residuals(
    ax: Axes, image: ImageResiduals, factor: float = 10.0, photograph: object = None
) -> None:
    """Draw the residuals of an image, from the measurement on.

    Args:
        ax: where.
        image: from ``bundle.figures.worst_residuals``.
        factor: by which lines are longer than residuals.
        photograph: what ``imshow`` takes, drawn below; None for none.
    """
    check_type("image", image, ImageResiduals)
    factor = number("factor", factor, above=0)
    width, height = image.size
    if photograph is not None and width > 0 and height > 0:
        ax.imshow(photograph, extent=(0, width, height, 0))  # type: ignore[arg-type]
    step = factor * image.residual
    ends = np.stack([image.xy, image.xy + step], axis=1)
    ax.plot(ends[..., 0].T, ends[..., 1].T, color=COLOURS[1], linewidth=0.8)
    if width > 0 and height > 0:
        ax.set(xlim=(0, width), ylim=(height, 0))
    elif not ax.yaxis_inverted():
        ax.invert_yaxis()
    ax.set(aspect="equal", xlabel="x [px]", ylabel="y [px]")
    name = image.error.name or f"image {image.error.image_id}"
    ax.set_title(f"{name}, x {factor:g}", fontsize=9, parse_math=False)


def draw_track_lengths(ax: Axes, tracks: TrackStatistics) -> None:
    """Draw the number of points by observations."""
    check_type("tracks", tracks, TrackStatistics)
    ax.bar(np.arange(len(tracks.lengths)), tracks.lengths, color=COLOURS[0])
    ax.set(xlabel="observations (the last bar: or more)", ylabel="points")


def draw_triangulation_angles(ax: Axes, tracks: TrackStatistics) -> None:
    """Draw the number of points by the largest angle of two of their rays."""
    check_type("tracks", tracks, TrackStatistics)
    edges = [0.0, *tracks.angle_limits, 90.0]
    place = np.arange(len(tracks.angles))
    ax.bar(place, tracks.angles, align="edge", width=1.0, color=COLOURS[0], edgecolor="white")
    ax.set_xticks(np.arange(len(edges)), [f"{edge:g}" for edge in edges])
    ax.set(xlabel="largest angle of two rays [degrees]", ylabel="points")


def _middles(field: ResidualField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows, columns = field.count.shape
    wide, high = field.cell_size
    x = field.box[0] + (np.arange(columns) + 0.5) * wide
    y = field.box[1] + (np.arange(rows) + 0.5) * high
    across, down = np.meshgrid(x, y)
    return across, down


def _plane(ax: Axes, field: ResidualField, title: str) -> None:
    left, top, right, bottom = field.box
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", title=title)
    ax.set(xlabel="x [px]", ylabel="y [px]")
