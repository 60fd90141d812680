"""What solving costs, before any arithmetic."""

from __future__ import annotations

from bundle.inspection.elimination import EliminationStep
from bundle.inspection.graph_file import GraphFile, load_graph
from bundle.inspection.graph_inspection import GRAPH_ORDERINGS, GraphInspection, inspect_graph
from bundle.inspection.inspection_result import Inspection, MethodInspection
from bundle.inspection.pose_graph_inspection import EliminationCost, PoseGraphInspection
from bundle.inspection.problem_inspection import inspect
from bundle.inspection.rank_limit import RankLimit, find_rank_limit
from bundle.inspection.rank_prediction import RankPrediction, predict_ranks
from bundle.inspection.schur_counts import SchurCounts, count_schur_by_hand

__all__ = [
    "GRAPH_ORDERINGS",
    "EliminationCost",
    "EliminationStep",
    "GraphFile",
    "GraphInspection",
    "Inspection",
    "MethodInspection",
    "PoseGraphInspection",
    "RankLimit",
    "RankPrediction",
    "SchurCounts",
    "count_schur_by_hand",
    "find_rank_limit",
    "inspect",
    "inspect_graph",
    "load_graph",
    "predict_ranks",
]
