"""Data of the figures of report pages; ``bundle.pictures`` draws the same data."""

from bundle.analysis.uncertainty.covariance_result import Certainty
from bundle.figures.lens_figures import LensCurve, lens_curve, most_observed_cameras
from bundle.figures.marks import Figure, Line, line_figure
from bundle.figures.odometry_figures import odometry_figures
from bundle.figures.placement_figures import Placement, placement
from bundle.figures.projection_uncertainty import ProjectionUncertainty, projection_uncertainty
from bundle.figures.residual_field import (
    RadialProfile,
    ResidualField,
    RowResiduals,
    residual_fields,
    row_residuals,
)
from bundle.figures.residual_figures import (
    ImageResiduals,
    ResidualHistogram,
    image_residuals,
    residual_histogram,
    worst_residuals,
)
from bundle.figures.scene_view import SceneView, scene_view
from bundle.figures.structure_figures import TrackStatistics, track_statistics
from bundle.model.residuals import Residuals, residuals

__all__ = [
    "Certainty",
    "Figure",
    "ImageResiduals",
    "LensCurve",
    "Line",
    "Placement",
    "ProjectionUncertainty",
    "RadialProfile",
    "ResidualField",
    "ResidualHistogram",
    "Residuals",
    "RowResiduals",
    "SceneView",
    "TrackStatistics",
    "image_residuals",
    "lens_curve",
    "line_figure",
    "most_observed_cameras",
    "odometry_figures",
    "placement",
    "projection_uncertainty",
    "residual_fields",
    "residual_histogram",
    "residuals",
    "row_residuals",
    "scene_view",
    "track_statistics",
    "worst_residuals",
]
