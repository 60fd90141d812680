"""Counts, tracks, lenses and suspicions of a model (bundle info)."""
