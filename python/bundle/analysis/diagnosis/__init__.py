"""Undetermined parameters and weak modes (bundle diagnose)."""
