"""Rounds of adjustment and filtering."""

from __future__ import annotations

from bundle.rounds.adjust_and_filter import solve_rounds
from bundle.rounds.filtering import Filtered, filter_observations
from bundle.rounds.round_options import RoundOptions

__all__ = ["Filtered", "RoundOptions", "filter_observations", "solve_rounds"]
