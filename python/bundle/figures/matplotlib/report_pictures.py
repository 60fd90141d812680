"""Figures of `bundle report`, of odometry pages and of costs, drawn on a Matplotlib axis."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bundle.analysis.uncertainty.covariance_result import Certainty
from bundle.base.arrays import check_type
from bundle.errors import InputError
from bundle.figures import lens_figures, placement_figures, residual_figures
from bundle.figures.cost_figures import (
    bar_figure,
    breakdown_figure,
    column_figure,
    profile_figure,
    time_figure,
)
from bundle.figures.lens_figures import LensCurve, correlation_figure
from bundle.figures.marks import Figure
from bundle.figures.matplotlib.draw import COLOURS, draw
from bundle.figures.placement_figures import Placement
from bundle.figures.projection_uncertainty import ProjectionUncertainty
from bundle.figures.residual_field import ResidualField, RowResiduals, row_figure
from bundle.figures.residual_figures import ImageResiduals, ResidualHistogram
from bundle.figures.scene_view import SceneView
from bundle.figures.structure_figures import (
    TrackStatistics,
    angle_figure,
    covisibility_figure,
    covisibility_graph,
    length_figure,
)
from bundle.interface.option_fields import choice, number
from bundle.model.problem import Problem
from bundle.planning.comparison.comparison_result import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CELLS = {"count": "count", "rms": "magnitude", "significance": "significance"}


def draw_lines(ax: Axes, figure: Figure) -> None:
    """Draw a figure, such as one of :func:`bundle.figures.odometry_figures`.

    Raises:
        InputError: ``figure`` is not such a figure.
    """
    check_type("figure", figure, Figure)
    draw(ax, figure)


def draw_residual_histogram(ax: Axes, histogram: ResidualHistogram) -> None:
    """Draw the distribution of residual coordinates, with a label for each set."""
    check_type("histogram", histogram, ResidualHistogram)
    draw(ax, residual_figures.coordinate_figure(histogram))


def draw_residual_lengths(ax: Axes, histogram: ResidualHistogram) -> None:
    """Draw the distribution of residual lengths on a logarithmic axis, with a label per set."""
    check_type("histogram", histogram, ResidualHistogram)
    draw(ax, residual_figures.length_figure(histogram))


def draw_residual_vectors(ax: Axes, field: ResidualField, factor: float | None = None) -> None:
    """Draw the mean residual of each cell, orange where it is significant.

    Args:
        ax: axis to draw on.
        field: residual field of a camera, from ``bundle.figures.residual_fields``.
        factor: ratio of drawn length to residual; None chooses a round factor.
    """
    check_type("field", field, ResidualField)
    factor = field.vector_factor if factor is None else number("factor", factor, above=0)
    figure = residual_figures.vector_figure(field, factor)
    draw(ax, figure, f"mean residual, x {factor:g}")


def draw_residual_cells(ax: Axes, field: ResidualField, what: str = "significance") -> None:
    """Draw a value per cell: "count", "rms" [pixels] or "significance" [standard errors]."""
    check_type("field", field, ResidualField)
    draw(ax, residual_figures.cell_figure(field, CELLS[choice("what", what, tuple(CELLS))]))


def draw_residual_directions(ax: Axes, field: ResidualField) -> None:
    """Draw residuals as dots, coloured by direction: clusters of one colour are systematic."""
    check_type("field", field, ResidualField)
    draw(ax, residual_figures.direction_figure(field))


def draw_radial_profile(ax: Axes, field: ResidualField) -> None:
    """Draw mean radial and tangential residuals against the distance from the principal point."""
    check_type("field", field, ResidualField)
    draw(ax, residual_figures.profile_figure(field))


def draw_row_residuals(ax: Axes, *sets: RowResiduals) -> None:
    """Draw the mean residuals of images by row, and what noise alone would give.

    Args:
        ax: axis to draw on.
        *sets: one set, or those before and after a solve, from ``bundle.figures.row_residuals``.
    """
    for one in sets:
        check_type("sets", one, RowResiduals)
    labels = ("now",) if len(sets) == 1 else ("before", "after")
    if len(sets) != len(labels):
        raise InputError(f"sets: expected one or two sets, found {len(sets)}")
    draw(ax, row_figure(dict(zip(labels, sets, strict=True))))


def draw_image_residuals(
    ax: Axes, image: ImageResiduals, factor: float = 10.0, photograph: object = None
) -> None:
    """Draw the residuals of an image, starting at the measurements.

    Args:
        ax: axis to draw on.
        image: residuals of an image, from ``bundle.figures.worst_residuals``.
        factor: ratio of drawn length to residual.
        photograph: background, any argument of ``imshow``; None without one.
    """
    check_type("image", image, ImageResiduals)
    factor = number("factor", factor, above=0)
    photograph = photograph if min(image.size) > 0 else None
    figure = residual_figures.image_figure(image, factor, photograph)
    draw(ax, figure, f"{residual_figures.image_name(image)}, x {factor:g}")


def draw_track_lengths(ax: Axes, tracks: TrackStatistics) -> None:
    """Draw the number of points against the number of their observations."""
    check_type("tracks", tracks, TrackStatistics)
    draw(ax, length_figure(tracks), "points by observations")


def draw_triangulation_angles(ax: Axes, tracks: TrackStatistics) -> None:
    """Draw the number of points against the largest angle between two of their rays."""
    check_type("tracks", tracks, TrackStatistics)
    draw(ax, angle_figure(tracks), "points by largest angle of two rays")


def draw_lens_curves(ax: Axes, curves: Sequence[LensCurve]) -> None:
    """Draw distortion against the distance from the principal point, and the observed radius.

    Args:
        ax: axis to draw on.
        curves: curves of cameras, from ``bundle.figures.lens_curve``; those with sigmas get a band.
    """
    for curve in curves:
        check_type("curves", curve, LensCurve)
    named = {f"camera {curve.camera_id}": curve for curve in curves}
    figure = lens_figures.lens_figure(named)
    if figure is not None:
        draw(ax, figure)


def draw_projection_uncertainty(
    ax: Axes, known: ProjectionUncertainty, distance: float | None = None
) -> None:
    """Draw the uncertainty of a projection over the image, with contours.

    Args:
        ax: axis to draw on.
        known: uncertainty of a camera, from ``bundle.figures.projection_uncertainty``.
        distance: distance of the points [length unit]; None: infinity.
    """
    check_type("known", known, ProjectionUncertainty)
    at = np.inf if distance is None else number("distance", distance, above=0)
    where = "at infinity" if distance is None else f"at a distance of {at:g}"
    draw(ax, lens_figures.sigma_figure(known, at), f"camera {known.camera_id}, {where}")


def draw_uncertainty_against_distance(ax: Axes, known: ProjectionUncertainty) -> None:
    """Draw the uncertainty of a projection against the distance; the median is a dotted line."""
    check_type("known", known, ProjectionUncertainty)
    draw(ax, lens_figures.distance_figure(known), f"camera {known.camera_id}")


def draw_target_errors(ax: Axes, place: Placement) -> None:
    """Draw horizontal errors of control and check points, and the error ellipses of the survey."""
    check_type("place", place, Placement)
    figure = placement_figures.target_figure(place)
    if figure is not None:
        draw(ax, figure)


def draw_position_errors(ax: Axes, place: Placement) -> None:
    """Draw horizontal errors of measured positions, and the ellipse of their mean squares."""
    check_type("place", place, Placement)
    figure = placement_figures.position_figure(place)
    if figure is not None:
        draw(ax, figure)


def draw_correlations(ax: Axes, problem: Problem, known: Certainty, camera: int) -> None:
    """Draw the correlation matrix of the refined parameters of a camera, given by its index.

    Raises:
        InputError: the camera has no covariance.
    """
    check_type("known", known, Certainty)
    if camera not in known.cameras:
        raise InputError(f"camera: expected one of {sorted(known.cameras)}, found {camera}")
    figure = correlation_figure(problem, known, camera)
    if figure is not None:
        draw(ax, figure)


def draw_covisibility(ax: Axes, problem: Problem, max_edges: int = 4000) -> None:
    """Draw the co-visibility graph with the images at their camera centres.

    Darker edges have more shared points. Cameras far outside, such as those of broken poses, are
    drawn at the border.
    """
    draw(ax, covisibility_figure(covisibility_graph(problem, max_edges)))


def draw_scene(ax: Axes, view: SceneView) -> None:
    """Draw points and camera centres on an axis with ``projection="3d"``, in the world's frame.

    Raises:
        InputError: the axis is two-dimensional.
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


def draw_flops(ax: Axes, flops: Mapping[str, float], *, impossible: Collection[str] = ()) -> None:
    """Draw the predicted flops of a step as bars on a log scale.

    Args:
        ax: axis to draw on.
        flops: flops of each method by name; NaN and 0 have no bar.
        impossible: names of methods that do not fit in memory; their bars are hatched.
    """
    check_type("flops", flops, Mapping)
    figure = bar_figure("flops", "predicted flops", flops, "{:.2g}".format, impossible)
    draw(ax, figure)
    ax.set_xlabel("flops of one step")


def draw_column_counts(ax: Axes, counts: Mapping[str, ArrayLike]) -> None:
    """Draw nonzeros below the diagonal of L by column, for each method.

    Profiles may have any number of bins; each profile extends over the full width of L.
    """
    check_type("counts", counts, Mapping)
    draw(ax, column_figure({name: np.asarray(given, float) for name, given in counts.items()}))


def draw_cost_against_time(ax: Axes, comparison: Comparison, problem: int = 0) -> None:
    """Draw the distance of each run's cost to the best cost against time, both logarithmic."""
    check_type("comparison", comparison, Comparison)
    draw(ax, time_figure(comparison, problem), comparison.problems[problem].name)


def draw_breakdown(ax: Axes, comparison: Comparison, problem: int = 0) -> None:
    """Draw the phases of each run as stacked bars, the fastest on top."""
    check_type("comparison", comparison, Comparison)
    draw(ax, breakdown_figure(comparison, problem), comparison.problems[problem].name)
    ax.set_xlabel("seconds")


def draw_performance_profile(ax: Axes, comparison: Comparison, gap: float = 1e-3) -> None:
    """Draw the share of problems that each method solves within a factor of the fastest.

    A problem is solved when the cost is within ``gap`` of the best. Without profiles for the gap,
    nothing is drawn; profiles require several problems.
    """
    check_type("comparison", comparison, Comparison)
    draw(ax, profile_figure(comparison, gap), f"performance profile, to {gap:g}")
