"""The same start under several methods: measured, compared, recommended."""

from bundle.comparison.compare import Progress, compare
from bundle.comparison.method import Method
from bundle.comparison.result import (
    GAPS,
    ComparedProblem,
    Comparison,
    Measurement,
    PerformanceProfile,
    Prediction,
    Recommendation,
    Run,
)

__all__ = [
    "GAPS",
    "ComparedProblem",
    "Comparison",
    "Measurement",
    "Method",
    "PerformanceProfile",
    "Prediction",
    "Progress",
    "Recommendation",
    "Run",
    "compare",
]
