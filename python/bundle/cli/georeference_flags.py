"""Measurements from the command line: their options, and the priors that they give."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.cli.carried_georeference import georeference_at
from bundle.cli.option_flags import flags_of, naming_flags, options_given
from bundle.errors import InputError, shown
from bundle.georeference.measurements import ROWS, Measurements, kinds_given, options_class, readers
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.option_fields import join

if TYPE_CHECKING:
    from bundle.model.problem import Problem


def georeference_given(
    arguments: argparse.Namespace,
    refined: Collection[str],
    *,
    page: bool = False,
    only_images: str | None = None,
) -> GeoreferenceOptions:
    """Return the options of all measurements.

    Args:
        page: True if a report page is written, which shows the photographs of ``--images``.

    Raises:
        InputError: a flag requires another flag or contradicts it, or the folder of images does
            not exist.
    """
    if page and arguments.images is not None and not Path(arguments.images).is_dir():
        raise InputError(f"--images: there is no folder {shown(arguments.images)}")
    given = options_given(arguments, options_class(), beside=("images",) if page else ())
    kinds = kinds_given(given)
    if not kinds:
        return given
    flags = prior_flags(given)
    reading = [row for row in kinds if row.from_photographs]
    read = [row for row in reading if getattr(given, row.source) == row.from_photographs]
    if read and given.images is None:
        word = f"{flags[read[0].source]} {read[0].from_photographs}"
        raise InputError(f"{word}: expected --images DIR, too")
    if given.images is not None and not read and not page:
        flag, word = flags[reading[0].source], reading[0].from_photographs
        raise InputError(f"--images: valid only with {flag} {word}, found {flag} with a file")
    if arguments.prior_loss_scale is not None and given.prior_loss == "trivial":
        raise InputError("--prior-loss-scale: valid only with a --prior-loss other than trivial")
    placed = any(row.places for row in kinds)
    for row in kinds:
        if row.needs_axes and not placed and georeference_at(arguments.input) is None:
            placing = dict.fromkeys(flags[one.source] for one in ROWS if one.places)
            places = join([*placing, "a georeference.json beside INPUT"])
            raise InputError(
                f"{flags[row.source]}: expected {places}, which say where east, north and up are, "
                f"found {shown(arguments.input)} without any"
            )
    if only_images is not None and placed:
        raise InputError(
            f"{flags['priors']}: not valid with --only-images, which leaves all other images in "
            "place"
        )
    if "poses" not in refined:
        raise InputError(f"{flags['priors']}: expected poses in --refine, found constant poses")
    return given


def prior_flags(given: GeoreferenceOptions) -> dict[str, str]:
    """Return the flags of measurements by the names of arguments; "priors" is about all of them."""
    flags, kinds = flags_of(type(given)), kinds_given(given)
    main = next((row for row in reversed(kinds) if row.places), kinds[0] if kinds else ROWS[0])
    return {**flags, "gcps": flags["gcp"], "priors": flags[main.source]}


def priors_of(given: GeoreferenceOptions, problem: Problem, *, kept: str = "") -> Measurements:
    """Return the priors that options give for a problem.

    Args:
        kept: reason for which the world must not turn, such as "with --only-images"; "": it may.

    Raises:
        InputError: a file or a flag is wrong; the message names the flag.
        OSError: a file cannot be read.
    """
    flags, found = prior_flags(given), []
    with naming_flags(**flags):
        for source, read in readers(given):
            with naming_flags(**{**flags, "priors": flags[source]}):
                found.append(read(problem))
                if kept:
                    found[-1].check_kept(problem, kept)
    return Measurements(tuple(found))
