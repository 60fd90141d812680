"""Measurements of a command line, their priors, and the georeference.json of OUTPUT."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.base.words import join
from bundle.cli.option_flags import flags_of, naming_flags, options_given
from bundle.errors import InputError, shown
from bundle.georeference.measurements import ROWS, Measurements, kinds_given, options_class, readers
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.io.atomic import atomic_write as atomic
from bundle.io.georeference_file import OWNER, georeference_of, owner_of, path_beside
from bundle.io.open import is_folder_format
from bundle.reports.sections import dumps, plain

if TYPE_CHECKING:
    from bundle.georeference.alignment_result import Alignment
    from bundle.georeference.georeferenced import Georeference
    from bundle.model.problem import Problem


def georeference_given(
    arguments: argparse.Namespace,
    refined: Collection[str],
    *,
    page: bool = False,
    beside: Collection[str] = (),
) -> GeoreferenceOptions:
    """Return the options of all measurements.

    ``page``: True if a report page is written, which shows the photographs of ``--images``.
    ``beside``: options that the command has by itself.
    """
    if page and arguments.images is not None and not Path(arguments.images).is_dir():
        raise InputError(f"--images: there is no folder {shown(arguments.images)}")
    given = options_given(arguments, options_class(), beside=(*beside, "images"))
    kinds = kinds_given(given)
    if given.images is not None and not page and not any(row.from_photographs for row in kinds):
        html = " or --html" * ("html" in vars(arguments))
        raise InputError(f"--images: valid only with --gps, --orientations, --velocities{html}")
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
                f"{flags[row.source]}: expected {places}, which define east, north and up, "
                f"found {shown(arguments.input)} without any"
            )
    if placed and getattr(arguments, "only_images", None) is not None:
        raise InputError(
            f"{flags['priors']}: not valid with --only-images, which leaves all other images in "
            "place"
        )
    if "poses" not in refined:
        raise InputError(f"{flags['priors']}: expected poses in --refine, found constant poses")
    return given


def prior_flags(given: GeoreferenceOptions) -> dict[str, str]:
    """Return the flags of measurements by the names of arguments; "priors" stands for all."""
    flags, kinds = flags_of(type(given)), kinds_given(given)
    main = next((row for row in reversed(kinds) if row.places), kinds[0] if kinds else ROWS[0])
    return {**flags, "gcps": flags["gcp"], "priors": flags[main.source]}


def priors_of(given: GeoreferenceOptions, problem: Problem, *, kept: str = "") -> Measurements:
    """Return the priors that options give for a problem.

    ``kept``: reason why the model must not move, such as "with --only-images"; "": it may.
    """
    flags, found = prior_flags(given), []
    with naming_flags(**flags):
        for source, read in readers(given):
            with naming_flags(**{**flags, "priors": flags[source]}):
                found.append(read(problem))
                if kept:
                    found[-1].check_kept(problem, kept)
    return Measurements(tuple(found))


# georeference.json next to an output; it always describes the model next to it.
#
# A command that georeferences a model writes the file. A command that keeps the frame of its input
# copies the input's file. If the input has no such file, the file of an earlier model at the output
# is removed with that model (``bundle.io``).

IDENTITY = {
    "scale": 1.0,
    "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "translation": [0.0, 0.0, 0.0],
}
FRAME = ("reference_system", "origin", "pipeline")


def georeference_at(source: str) -> dict[str, Any] | None:
    """Return the georeference next to a model; None without one."""
    return georeference_of(Path(source), is_folder=Path(source).is_dir())


def check_georeference(path: str, format: str) -> None:
    """Refuse an output where no georeference can be written, or where another model has one."""
    model = Path(path)
    beside = path_beside(model, is_folder=is_folder_format(format))
    if not beside.parent.is_dir():
        return
    atomic.check_file(beside)
    owner = owner_of(beside)
    if is_folder_format(format) or owner in (None, model.name):
        return
    if not owner or (beside.parent / owner).exists():
        what = shown(owner) if owner else "the model in its folder"
        raise InputError(
            f"{shown(path)}: expected a folder without the {beside.name} of another model, found "
            f"that of {what}; give a path in a new folder"
        )


def write_georeference(
    georeference: Georeference | Alignment, path: str, format: str, reference: str | None = None
) -> None:
    """Write georeference.json completely or not at all; ``reference`` is a model in its frame."""
    found = plain(georeference.asdict())
    frame = None if reference is None else georeference_at(reference)
    _write(found | ({} if frame is None else _frame(frame)), path, format)


def carry_georeference(
    found: dict[str, Any] | None, path: str, format: str, changed: str = ""
) -> None:
    """Write the georeference of an input, if any, next to a model in the same frame.

    ``changed`` is a sentence about a change of the model, which drops the errors at measurements.
    """
    if found is None:
        return
    if changed:
        found = _frame(found) | {
            "similarity": IDENTITY,
            "gps": [],
            "gcps": [],
            "rms_enu": None,
            "rms_enu_check": None,
            "notes": [changed],
        }
    _write(found, path, format)


def _frame(found: dict[str, Any]) -> dict[str, Any]:
    return {name: found.get(name) for name in FRAME}


def _write(found: dict[str, Any], path: str, format: str) -> None:

    model = Path(path)
    content = {name: value for name, value in found.items() if name != OWNER}
    if not is_folder_format(format):
        content[OWNER] = model.name
    beside = path_beside(model, is_folder=is_folder_format(format))
    atomic.write_text(beside, dumps(content))
