"""Pictures of problems, orderings and comparisons: functions of a Matplotlib axis.

``figure()`` makes one, and what it returns saves PNG and SVG::

    made, axes = bundle.pictures.figure()
    bundle.pictures.draw_covisibility(axes[0, 0], problem)
    made.savefig("covisibility.svg")

Matplotlib is not installed with bundle: ``pip install matplotlib``.
"""

from bundle.pictures.charts import (
    draw_breakdown,
    draw_column_counts,
    draw_cost_against_time,
    draw_flops,
    draw_performance_profile,
)
from bundle.pictures.covisibility_graph import draw_covisibility
from bundle.pictures.figure import figure
from bundle.pictures.line_pictures import draw_lines
from bundle.pictures.matrix_pattern import MatrixPattern
from bundle.pictures.placement_pictures import (
    draw_correlations,
    draw_position_errors,
    draw_target_errors,
)
from bundle.pictures.problem_patterns import (
    ORDERINGS,
    information_pattern,
    order_blocks,
    reduced_pattern,
)
from bundle.pictures.projection_pictures import (
    draw_projection_uncertainty,
    draw_uncertainty_against_distance,
)
from bundle.pictures.residual_pictures import (
    draw_image_residuals,
    draw_radial_profile,
    draw_residual_cells,
    draw_residual_directions,
    draw_residual_histogram,
    draw_residual_lengths,
    draw_residual_vectors,
    draw_track_lengths,
    draw_triangulation_angles,
)
from bundle.pictures.scene_pictures import draw_lens_curves, draw_scene
from bundle.pictures.spy import draw_orderings, spy, spy_factor

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
