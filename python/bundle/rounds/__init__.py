"""Rounds of adjustment and filtering."""

from __future__ import annotations

from bundle.rounds.filtering import Filtered, filter_observations

__all__ = ["Filtered", "filter_observations"]
