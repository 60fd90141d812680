"""The same start under several methods: measured, compared, recommended."""

from bundle.compare_defaults import REPEAT, TIMEOUT
from bundle.comparison.compare_methods import compare
from bundle.comparison.comparison_result import (
    GAPS,
    ComparedProblem,
    Comparison,
    Measurement,
    PerformanceProfile,
    Prediction,
    Recommendation,
    Run,
)
from bundle.comparison.graph_comparison import GraphComparison, GraphMethod, GraphRun
from bundle.comparison.method import Method
from bundle.comparison.work import Progress

__all__ = [
    "GAPS",
    "REPEAT",
    "TIMEOUT",
    "ComparedProblem",
    "Comparison",
    "GraphComparison",
    "GraphMethod",
    "GraphRun",
    "Measurement",
    "Method",
    "PerformanceProfile",
    "Prediction",
    "Progress",
    "Recommendation",
    "Run",
    "compare",
]
