"""Flags of loops that are closed before bundle adjustment."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bundle.cli.option_flags import choice_word, naming_flags
from bundle.cli.path_checks import a_path
from bundle.errors import InputError
from bundle.interface.loop_losses import LOOP_LOSSES

if TYPE_CHECKING:
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.model.problem import Problem

__all__ = ["add_loop_flags", "check_loop_flags", "loops_closed"]


def add_loop_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of loop closures."""
    group = parser.add_argument_group("loops")
    group.add_argument(
        "--loops",
        metavar="FILE.g2o",
        type=a_path,
        help="first close these loops by a graph of the images' poses, points carried along: edges "
        "between ids of images, EDGE_SE3:QUAT i j with the pose of camera j in the frame of camera "
        "i, in the length unit of the model around image i (default: none)",
    )
    group.add_argument(
        "--loop-loss",
        choices=[choice_word(word) for word in LOOP_LOSSES],
        default=None,
        help="robust loss by which right closures are told from wrong ones; half of them have to "
        "be right; trivial takes all (default: cauchy)",
    )
    group.add_argument(
        "--loop-loss-scale",
        metavar="X",
        type=float,
        default=None,
        help="sigmas at which that loss begins to bend; a closure is right within 4.9 times as "
        "many (default: 1)",
    )


def check_loop_flags(arguments: argparse.Namespace) -> None:
    """Refuse flags that mean nothing together.

    Raises:
        InputError: a flag of loops without loops, or loops beside images that are to stay.
    """
    if arguments.loops is None:
        for name in ("loop_loss", "loop_loss_scale"):
            if getattr(arguments, name) is not None:
                raise InputError(f"--{name.replace('_', '-')}: expected with --loops only")
    elif arguments.only_images is not None:
        raise InputError("--loops: expected without --only-images, which leave the rest in place")


def loops_closed(arguments: argparse.Namespace, problem: Problem) -> LoopClosing:
    """Return the problem with its loops closed.

    Raises:
        InputError: as :func:`bundle.close_loops`.
    """
    from bundle.graphs.loops.loop_graph import close_loops

    given = {"loss": arguments.loop_loss, "loss_scale": arguments.loop_loss_scale}
    with naming_flags(loss="--loop-loss", loss_scale="--loop-loss-scale"):
        return close_loops(
            problem, arguments.loops, **{k: v for k, v in given.items() if v is not None}
        )
