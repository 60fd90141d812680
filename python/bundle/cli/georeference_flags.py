"""Positions and control points from the command line, as checked options and as priors."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.cli.option_flags import flags_of, naming_flags, options_given
from bundle.errors import InputError, shown
from bundle.interface.georeference_options import GeoreferenceOptions

if TYPE_CHECKING:
    from bundle.georeference.gcp_priors import GcpPriors
    from bundle.georeference.gps_priors import GpsPriors
    from bundle.model.problem import Problem

__all__ = ["GEOREFERENCE_FLAGS", "georeference_given", "main_flag", "priors_of", "settings_of"]

GEOREFERENCE_FLAGS = {**flags_of(GeoreferenceOptions), "gcps": "--gcp"}
"""Flags of the arguments of ``gps_priors``, ``gcp_priors`` and :func:`bundle.align`."""


def georeference_given(
    arguments: argparse.Namespace,
    refined: Collection[str],
    *,
    page: bool = False,
    only_images: str | None = None,
) -> GeoreferenceOptions:
    """Return the options of positions and control points.

    Args:
        arguments: parsed command line.
        refined: kinds of refined parameters.
        page: True if a report page is written, which shows the photographs of ``--images``.
        only_images: images that the solve refines.

    Raises:
        InputError: a flag requires another flag or contradicts it, or the folder of images does
            not exist.
    """
    if page and arguments.images is not None and not Path(arguments.images).is_dir():
        raise InputError(f"--images: there is no folder {shown(arguments.images)}")
    beside = ("images",) if page else ()
    given = options_given(arguments, GeoreferenceOptions, beside=beside)
    if not given.is_given:
        return given
    if given.gps == "exif" and given.images is None:
        raise InputError("--gps exif: expected --images DIR, too")
    if given.gps not in (None, "exif") and given.images is not None and not page:
        raise InputError("--images: valid only with --gps exif, found --gps with a file")
    if arguments.prior_loss_scale is not None and given.prior_loss == "trivial":
        raise InputError("--prior-loss-scale: valid only with a --prior-loss other than trivial")
    flag = main_flag(given)
    if only_images is not None:
        raise InputError(
            f"{flag}: not valid with --only-images, which leaves all other images in place"
        )
    if "poses" not in refined:
        raise InputError(f"{flag}: expected poses in --refine, found constant poses")
    return given


def main_flag(given: GeoreferenceOptions) -> str:
    """Return the flag for errors about all priors."""
    return "--gps" if given.gcp is None else "--gcp"


def priors_of(given: GeoreferenceOptions, problem: Problem) -> GcpPriors | GpsPriors | None:
    """Return the priors of images and control points; None without any.

    Raises:
        InputError: a file or a flag is wrong; the message names the flag.
        OSError: a file cannot be read.
    """
    if not given.is_given:
        return None
    # Only geographic coordinates need pyproj.
    from bundle.georeference.gcp_priors import gcp_priors
    from bundle.georeference.gps_priors import gps_priors

    with naming_flags(**GEOREFERENCE_FLAGS):
        settings = settings_of(given)
        if given.gps != "exif":  # the folder is for the report page
            settings.pop("images", None)
        if given.gcp is None:
            return gps_priors(problem, **settings)
        return gcp_priors(problem, **settings)


def settings_of(given: GeoreferenceOptions) -> dict[str, Any]:
    """Return non-default arguments of ``gps_priors``, ``gcp_priors`` and ``align``.

    Raises:
        InputError: the antenna position is invalid.
    """
    settings = given.changed()
    if "antenna" in settings:
        settings["antenna"] = given.lever_arm
    if "gcp" in settings:
        settings["gcps"] = settings.pop("gcp")
    if "check_points" in settings:
        settings["check_points"] = given.check_point_names
    return settings
