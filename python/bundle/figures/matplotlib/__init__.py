"""Pictures of problems, orderings and comparisons: functions that draw on Matplotlib axes.

``figure()`` creates a figure, which can be saved as PNG or SVG::

    made, axes = bundle.pictures.figure()
    bundle.pictures.draw_covisibility(axes[0, 0], problem)
    made.savefig("covisibility.svg")

Matplotlib is not installed with bundle: ``pip install matplotlib``.
"""

from bundle.figures.matplotlib.draw import figure
from bundle.figures.matplotlib.matrix_pattern import (
    ORDERINGS,
    MatrixPattern,
    draw_orderings,
    information_pattern,
    order_blocks,
    reduced_pattern,
    spy,
    spy_factor,
)
from bundle.figures.matplotlib.report_pictures import (
    draw_breakdown,
    draw_column_counts,
    draw_correlations,
    draw_cost_against_time,
    draw_covisibility,
    draw_flops,
    draw_image_residuals,
    draw_lens_curves,
    draw_lines,
    draw_performance_profile,
    draw_position_errors,
    draw_projection_uncertainty,
    draw_radial_profile,
    draw_residual_cells,
    draw_residual_directions,
    draw_residual_histogram,
    draw_residual_lengths,
    draw_residual_vectors,
    draw_row_residuals,
    draw_scene,
    draw_target_errors,
    draw_track_lengths,
    draw_triangulation_angles,
    draw_uncertainty_against_distance,
)

__all__ = [
    "ORDERINGS",
    "MatrixPattern",
    "draw_breakdown",
    "draw_column_counts",
    "draw_correlations",
    "draw_cost_against_time",
    "draw_covisibility",
    "draw_flops",
    "draw_image_residuals",
    "draw_lens_curves",
    "draw_lines",
    "draw_orderings",
    "draw_performance_profile",
    "draw_position_errors",
    "draw_projection_uncertainty",
    "draw_radial_profile",
    "draw_residual_cells",
    "draw_residual_directions",
    "draw_residual_histogram",
    "draw_residual_lengths",
    "draw_residual_vectors",
    "draw_row_residuals",
    "draw_scene",
    "draw_target_errors",
    "draw_track_lengths",
    "draw_triangulation_angles",
    "draw_uncertainty_against_distance",
    "figure",
    "information_pattern",
    "order_blocks",
    "reduced_pattern",
    "spy",
    "spy_factor",
]
