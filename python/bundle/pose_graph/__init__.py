"""Pose graphs: poses and what is known of pairs of them, in the plane and in space."""

from bundle.pose_graph.pose_graph_arrays import PoseGraph
from bundle.pose_graph.pose_graph_result import PoseGraphResult, PoseGraphSummary
from bundle.pose_graph.solve_pose_graph import initial_poses, pose_graph_chi2, solve_pose_graph

__all__ = [
    "PoseGraph",
    "PoseGraphResult",
    "PoseGraphSummary",
    "initial_poses",
    "pose_graph_chi2",
    "solve_pose_graph",
]
