"""Flags that change the cameras of the input before anything else happens."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bundle.cli.option_flags import naming_flags, parse_ids
from bundle.errors import InputError

if TYPE_CHECKING:
    from bundle.editing.cameras.edit_record import CameraEdits
    from bundle.model.problem import Problem

__all__ = ["add_lens_flags", "cameras_edited"]


def add_lens_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``bundle.editing.cameras``."""
    group = parser.add_argument_group("cameras of OUTPUT")
    group.add_argument(
        "--camera-model",
        metavar="MODEL",
        help="model that all cameras get, such as OPENCV; from the same pixels, exactly where the "
        "model can, else by a fit, whose error is reported (default: they keep theirs)",
    )
    group.add_argument(
        "--share-cameras",
        metavar="IDS|all",
        type=_ids_or_all,
        help="make these cameras, of one model and size, the one with the lowest id; parameters "
        "are the means weighted by observations (such as 1,2,5-9; default: none)",
    )
    group.add_argument(
        "--split-cameras",
        action="store_true",
        help="give each image a camera of its own (default: off)",
    )


def cameras_edited(arguments: argparse.Namespace, problem: Problem) -> CameraEdits | None:
    """Return the problem with the cameras that were asked for; None where nothing was.

    Raises:
        InputError: this cannot be done; the message names the flag, or the camera.
    """
    share = arguments.share_cameras
    if arguments.camera_model is None and share is None and not arguments.split_cameras:
        return None
    if share is not None and arguments.split_cameras:
        raise InputError("--split-cameras: expected without --share-cameras, found both")
    from bundle.editing.cameras.edit_record import edit_cameras

    with naming_flags(model="--camera-model", camera_ids="--share-cameras"):
        return edit_cameras(
            problem,
            arguments.camera_model,
            share=False if share is None else share,
            split=arguments.split_cameras,
        )


def _ids_or_all(text: str) -> tuple[int, ...] | bool:
    return True if text == "all" else parse_ids(text)
