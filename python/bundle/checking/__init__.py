"""Comparison of Jacobians with independent references."""
