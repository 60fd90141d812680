"""Jacobians against independent references."""
