"""Losses by which right loop closures are told from wrong ones."""

__all__ = ["LOOP_LOSSES"]

LOOP_LOSSES = ("trivial", "huber", "soft_l1", "cauchy")
"""Those that pull however far a closure is from the model, as before a loop is closed all are."""
