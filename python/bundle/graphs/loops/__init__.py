"""Loops of drifted models, closed by a graph of images before bundle adjustment."""
