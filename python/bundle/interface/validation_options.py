"""Options of held-out observations."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

__all__ = ["MOST_PERCENT", "HoldOutOptions"]

MOST_PERCENT = 50.0
"""Largest share of the observations that can be held out."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class HoldOutOptions(Options):
    """Options of :func:`bundle.hold_out`, for the error of a solve that its fit did not see."""

    hold_out: float = option(
        0.0,
        "--hold-out",
        "also fit without this share of the observations, in percent, and report how well that fit "
        "predicts them; OUTPUT is the fit to all observations. The share is drawn in each image; "
        "each point keeps observations in two images. With --only-images it is drawn in these. 0: "
        "do not",
        minimum=0.0,
        maximum=MOST_PERCENT,
        metavar="PERCENT",
    )
    hold_out_seed: int = option(
        0,
        "--hold-out-seed",
        "seed of the draw; another seed holds out other observations",
        minimum=0,
        metavar="N",
        needs=("hold_out",),
    )
