"""The numbers behind the figures of a report page, which ``bundle.pictures`` draws too."""

from bundle.figures.image_residuals import ImageResiduals, image_residuals, worst_residuals
from bundle.figures.residual_field import RadialProfile, ResidualField, residual_fields
from bundle.figures.residual_histogram import ResidualHistogram, residual_histogram
from bundle.figures.residuals import Residuals, residuals
from bundle.figures.track_statistics import TrackStatistics, track_statistics

__all__ = [
    "ImageResiduals",
    "RadialProfile",
    "ResidualField",
    "ResidualHistogram",
    "Residuals",
    "TrackStatistics",
    "image_residuals",
    "residual_fields",
    "residual_histogram",
    "residuals",
    "track_statistics",
    "worst_residuals",
]
