"""Rounds of solves and filters, checkpoints, local adjustment."""
