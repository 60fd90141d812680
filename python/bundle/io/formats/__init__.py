"""Reconstructions in files of other programs: their registry, readers and writers."""
