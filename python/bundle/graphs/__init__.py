"""Factors, pose graphs, loop closing."""
