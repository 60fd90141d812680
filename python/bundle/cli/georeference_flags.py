"""Priors from the command line: positions, control points, attitudes and velocities."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.cli.carried_georeference import georeference_at
from bundle.cli.option_flags import flags_of, naming_flags, options_given
from bundle.errors import InputError, shown
from bundle.interface.georeference_options import GeoreferenceOptions

if TYPE_CHECKING:
    from bundle.georeference.known_priors import KnownPriors
    from bundle.georeference.survey_priors import GcpPriors, GpsPriors
    from bundle.model.problem import Problem

GEOREFERENCE_FLAGS = {**flags_of(GeoreferenceOptions), "gcps": "--gcp"}
"""Flags of the arguments of ``gps_priors``, ``gcp_priors`` and :func:`bundle.align`."""


def georeference_given(
    arguments: argparse.Namespace,
    refined: Collection[str],
    *,
    page: bool = False,
    only_images: str | None = None,
) -> GeoreferenceOptions:
    """Return the options of positions, control points, attitudes and velocities.

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
    sources = {"gps": "exif", "orientations": "xmp", "velocities": "xmp"}
    read = [f"--{name} {word}" for name, word in sources.items() if getattr(given, name) == word]
    if read and given.images is None:
        raise InputError(f"{read[0]}: expected --images DIR, too")
    if given.images is not None and not read and not page:
        kind = next(f"--{name} {sources[name]}" for name in sources if getattr(given, name))
        raise InputError(f"--images: valid only with {kind}, found {kind.split()[0]} with a file")
    if arguments.prior_loss_scale is not None and given.prior_loss == "trivial":
        raise InputError("--prior-loss-scale: valid only with a --prior-loss other than trivial")
    if (
        given.velocities is not None
        and not given.has_positions
        and georeference_at(arguments.input) is None
    ):
        raise InputError(
            "--velocities: expected --gps, --gcp or a georeference.json beside INPUT, which say "
            f"where east, north and up are, found {shown(arguments.input)} without any"
        )
    if given.gps_offset != "none" and given.gcp is None:
        raise InputError("--gps-offset: expected --gcp, too: control points determine the offset")
    flag = main_flag(given)
    if only_images is not None and given.has_positions:
        raise InputError(
            f"{flag}: not valid with --only-images, which leaves all other images in place"
        )
    if "poses" not in refined:
        raise InputError(f"{flag}: expected poses in --refine, found constant poses")
    return given


def main_flag(given: GeoreferenceOptions) -> str:
    """Return the flag for errors about all priors."""
    flags = {
        "--gcp": given.gcp,
        "--gps": given.gps,
        "--gravity": given.gravity,
        "--orientations": given.orientations,
        "--velocities": given.velocities,
    }
    return next((flag for flag, value in flags.items() if value is not None), "--gps")


def priors_of(
    given: GeoreferenceOptions, problem: Problem, *, kept: str = ""
) -> KnownPriors | None:
    """Return the priors of images and control points; None without any.

    Args:
        given: options of the command line.
        problem: problem of the images.
        kept: reason for which the world must not turn, such as "with --only-images"; "": it may.

    Raises:
        InputError: a file or a flag is wrong; the message names the flag.
        OSError: a file cannot be read.
    """
    if not given.is_given:
        return None
    from bundle.georeference.known_priors import KnownPriors  # most runs have no priors

    survey = attitudes = velocities = None
    with naming_flags(**GEOREFERENCE_FLAGS):
        if given.has_positions:
            survey = _survey(given, problem)
        if given.has_attitudes:
            from bundle.georeference.attitudes import read_attitudes

            attitudes = read_attitudes(problem, **_settings(given, _OF_ATTITUDES)).scaled(
                given.gravity_sigma_scale, given.orientation_sigma_scale
            )
            if kept:
                attitudes.check_upright(problem, kept)
    if given.velocities is not None:
        from bundle.georeference.velocities import read_velocities

        settings = _settings(given, _OF_VELOCITIES)
        if "antenna" in settings:
            settings["antenna"] = given.lever_arm
        with naming_flags(**{**GEOREFERENCE_FLAGS, "priors": "--velocities"}):
            velocities = read_velocities(problem, **settings)
    return KnownPriors(survey, attitudes, velocities)


def _survey(given: GeoreferenceOptions, problem: Problem) -> GcpPriors | GpsPriors:
    """Return the priors of positions and control points."""
    # Only geographic coordinates need pyproj.
    from bundle.georeference.survey_priors import gcp_priors, gps_priors

    settings = settings_of(given, problem)
    if given.gps != "exif":  # the folder is for the report page
        settings.pop("images", None)
    if given.gcp is None:
        return gps_priors(problem, **settings)
    return gcp_priors(problem, **settings)


_SCALES = {"gps_sigma_scale", "gravity_sigma_scale", "orientation_sigma_scale"}
_ONLY_ATTITUDES = {"gravity", "gravity_sigma", "orientations", "orientation_sigma"}
_SHARED = {"images", "prior_loss", "prior_loss_scale"}
_OF_ATTITUDES = {*_ONLY_ATTITUDES, *_SHARED}
_ONLY_VELOCITIES = {"velocities", "velocity_sigma"}
_OF_VELOCITIES = {*_ONLY_VELOCITIES, *_SHARED, "antenna"}


def _settings(given: GeoreferenceOptions, names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in given.changed().items() if name in names}


def settings_of(given: GeoreferenceOptions, problem: Problem) -> dict[str, Any]:
    """Return non-default arguments of ``gps_priors``, ``gcp_priors`` and ``align``.

    Positions with scaled standard deviations are read here.

    Raises:
        InputError: the antenna position is invalid.
    """
    names = set(given.names()) - _ONLY_ATTITUDES - _ONLY_VELOCITIES - _SCALES
    settings = _settings(given, names)
    if given.changed().keys() & {"gps_sigma_scale"}:
        from bundle.georeference.given_positions import scaled_gps  # few runs have a scale

        images = settings.pop("images", None) if given.gps == "exif" else None
        scales = given.gps_sigma, given.gps_sigma_scale
        settings["gps"] = scaled_gps(given.gps, images, problem, *scales)
    if "antenna" in settings:
        settings["antenna"] = given.lever_arm
    if "gcp" in settings:
        settings["gcps"] = settings.pop("gcp")
    if "check_points" in settings:
        settings["check_points"] = given.check_point_names
    return settings
