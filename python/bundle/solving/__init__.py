"""Solve: turn a request into a result."""
