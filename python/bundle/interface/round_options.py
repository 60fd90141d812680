"""How many rounds there are, and the limits of their filter."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

__all__ = ["CHECKPOINT_INTERVAL", "RESTS", "RoundOptions"]

CHECKPOINT_INTERVAL = 20
"""Iterations from one checkpoint to the next within a round."""

RESTS = ("fixed", "marginal")
"""What happens to all that a local adjustment does not refine."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class RoundOptions(Options):
    """Options of :func:`bundle.solve_rounds` and of its filter."""

    num_rounds: int = option(
        0,
        "--rounds",
        "maximum number of rounds: adjust, then remove observations and points beyond the limits; "
        "the last round too. They end early when a round removes less than 0.05 % of its "
        "observations; what the last one leaves is adjusted once more. 0: adjust once, remove "
        "nothing",
        minimum=0,
        metavar="N",
    )
    max_error: float = option(
        4.0,
        "--max-error",
        "largest reprojection error that a round leaves, in pixels",
        above=0.0,
        metavar="PIXELS",
    )
    min_angle: float = option(
        1.5,
        "--min-angle",
        "smallest triangulation angle of a point (the largest over pairs of its observations) that "
        "a round leaves, in degrees; 0: any",
        minimum=0.0,
        maximum=90.0,
        metavar="DEGREES",
    )
    min_track_length: int = option(
        2,
        "--min-track",
        "smallest number of observations of a point that a round leaves",
        minimum=0,
        metavar="N",
    )
