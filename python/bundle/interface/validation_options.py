"""Options of held-out observations, and of the validation of candidates by them."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

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


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ValidationOptions(Options):
    """Options of :func:`bundle.validate`: the candidates and the folds."""

    camera_models: tuple[str, ...] | None = option(
        None,
        "--camera-models",
        "lens models, such as SIMPLE_RADIAL,OPENCV",
        metavar="LIST",
        value="words",
        unset="those of INPUT's kind, from the smallest to the largest",
    )
    share: tuple[str, ...] | None = option(
        None,
        "--share",
        "sharings. each: a lens per image; focal: a focal length per image, all else shared by "
        "images of one size; size: a lens per image size; all: one lens; input: as in INPUT",
        metavar="LIST",
        value="words",
        unset="those that make a difference",
    )
    losses: tuple[str, ...] | None = option(
        None,
        "--losses",
        "robust losses of the fits",
        metavar="LIST",
        value="words",
        unset="cauchy",
    )
    refine_sets: str | None = option(
        None,
        "--refine",
        "sets of refined parameters, separated by /, such as "
        "poses,points,focal,extra/poses,points,focal,principal-point,extra",
        metavar="SETS",
        unset="poses,points,focal,extra",
    )
    num_folds: int = option(
        5,
        "--folds",
        "number of folds, the same for all candidates; each is predicted by a fit to the others",
        minimum=2,
        maximum=1000,
        metavar="K",
    )
    seed: int = option(
        0, "--seed", "seed of the folds; another seed divides otherwise", minimum=0, metavar="N"
    )

    @property
    def refined(self) -> tuple[tuple[str, ...], ...]:
        """Sets of refined parameters; () for the default."""
        if self.refine_sets is None:
            return ()
        sets = self.refine_sets.split("/")
        return tuple(tuple(name.strip() for name in one.split(",") if name.strip()) for one in sets)
