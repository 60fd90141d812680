"""Factor graphs: variables on manifolds, factors between them, one solve."""

from bundle.graph.digits import DigitsLeft
from bundle.graph.factor_check import FactorCheck
from bundle.graph.factor_graph import FactorGraph
from bundle.graph.factors import (
    BetweenFactor,
    Factor,
    PositionFactor,
    PriorFactor,
    RelativePoseFactor,
    ReprojectionFactor,
    ScalarPriorFactor,
)
from bundle.graph.function_factor import FunctionFactor
from bundle.graph.graph_result import GraphResult
from bundle.graph.incremental_smoother import IncrementalSmoother, IncrementalUpdate
from bundle.graph.linear_prior import LinearPrior
from bundle.graph.problem_factors import check_factors
from bundle.graph.spectrum import PriorSpectrum
from bundle.graph.square_root_prior import SquareRootPrior

__all__ = [
    "BetweenFactor",
    "DigitsLeft",
    "Factor",
    "FactorCheck",
    "FactorGraph",
    "FunctionFactor",
    "GraphResult",
    "IncrementalSmoother",
    "IncrementalUpdate",
    "LinearPrior",
    "PositionFactor",
    "PriorFactor",
    "PriorSpectrum",
    "RelativePoseFactor",
    "ReprojectionFactor",
    "ScalarPriorFactor",
    "SquareRootPrior",
    "check_factors",
]
