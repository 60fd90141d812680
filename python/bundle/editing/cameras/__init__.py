"""Cameras that change their model, are shared or split."""
