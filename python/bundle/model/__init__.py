"""Reconstructions, pose graphs and sequences as arrays."""
