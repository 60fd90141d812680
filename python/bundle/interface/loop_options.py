"""Options of loops that are closed before bundle adjustment (:func:`bundle.close_loops`)."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

__all__ = ["LOOP_LOSSES", "LoopOptions"]

LOOP_LOSSES = ("trivial", "huber", "soft_l1", "cauchy")
"""Losses whose gradient does not vanish for large errors. Before a loop is closed, the errors of
all its closures are large."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LoopOptions(Options):
    """Loop closures, and the loss that separates correct closures from wrong ones."""

    loops: str | None = option(
        None,
        "--loops",
        "first close these loops by a graph of the images' poses, points carried along: edges "
        "between ids of images, EDGE_SE3:QUAT i j with the pose of camera j in the frame of camera "
        "i, in the length unit of the model around image i",
        metavar="FILE.g2o",
        value="path",
    )
    loop_loss: str = option(
        "cauchy",
        "--loop-loss",
        "robust loss by which right closures are told from wrong ones; half of them have to be "
        "right; trivial takes all",
        choices=LOOP_LOSSES,
        needs=("loops",),
        late=True,
    )
    loop_loss_scale: float = option(
        1.0,
        "--loop-loss-scale",
        "sigmas at which that loss begins to bend; a closure is right within 4.9 times as many",
        metavar="X",
        needs=("loops",),
        late=True,
    )
