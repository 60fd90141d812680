"""Pose graphs: starts, robust solves, consistency."""
