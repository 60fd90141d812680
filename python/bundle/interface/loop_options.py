"""Options of loops that are closed before bundle adjustment (:func:`bundle.close_loops`)."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

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
        "file of loop closures, which a graph of the images' poses closes before the solve; points "
        "move with their images. Edges are between image ids: EDGE_SE3:QUAT i j with the pose of "
        "camera j in the frame of camera i, in the length unit of the model near image i",
        metavar="FILE.g2o",
        value="path",
    )
    loop_loss: str = option(
        "cauchy",
        "--loop-loss",
        "robust loss that separates right from wrong closures; at least half of them must be "
        "right; trivial uses all",
        choices=LOOP_LOSSES,
        needs=("loops",),
        late=True,
    )
    loop_loss_scale: float = option(
        1.0,
        "--loop-loss-scale",
        "sigmas at which this loss begins to bend; a closure is right if its error is within 4.9 "
        "times this value",
        metavar="X",
        needs=("loops",),
        late=True,
    )
