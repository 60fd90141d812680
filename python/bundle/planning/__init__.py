"""Predicted and measured cost of solvers."""
