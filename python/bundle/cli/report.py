"""`bundle report`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import perf_counter
from typing import Any

from bundle.cli.constraint_flags import add_constraint_flags, constraints_given
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.gps_flags import NAMED, add_gps_flags, check_gps_flags, main_flag
from bundle.cli.option_flags import naming_flags
from bundle.cli.parser import add_input, add_rig_config, with_rigs
from bundle.cli.path_checks import page_path
from bundle.interface.options import SolveOptions

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "report"
HELP = "one page (HTML, no network) on a reconstruction: residuals, lenses, tracks, a 3-D view"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle report INPUT -o FILE.html [options]"
    add_input(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE.html",
        type=page_path(),
        required=True,
        help="the page to write, a single file",
    )
    add_rig_config(parser)
    add_constraint_flags(parser)
    add_gps_flags(
        parser,
        "The priors of the refine that made INPUT, by the same flags: how certain it is depends on "
        "them. Nothing is moved.",
        "--gps exif and residuals of the worst images on their photographs",
    )
    parser.set_defaults(html="", only_images=None)  # of a refine with a page


def placed(source: str) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """Return the content of the georeference.json that `bundle refine` left there, if it did.

    Returns:
        None without one; and a sentence where the file holds something else.
    """
    from bundle.errors import shown
    from bundle.io.georeference_file import owner_of, path_beside

    is_folder = Path(source).is_dir()
    path = path_beside(Path(source), is_folder=is_folder)
    of_it = owner_of(path) in (None, "" if is_folder else Path(source).name)
    if not path.is_file() or not of_it:
        return None, ()
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        found = None
    if not isinstance(found, dict) or not {"gps", "gcps", "reference_system"} <= found.keys():
        return None, (f"{shown(str(path))} is not what bundle refine writes: left out.",)
    return found, ()


def run(arguments: argparse.Namespace) -> int:
    """Write the page on INPUT."""
    started = perf_counter()
    from bundle.cli.gps_flags import priors_given
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.errors import InputError, shown
    from bundle.io.open import load
    from bundle.reports.page.report_page import write_report
    from bundle.reports.terminal.report import reported

    source, page = arguments.input, arguments.output
    if page == "-":
        raise InputError("--output: expected a file for the page, found -")
    check_gps_flags(arguments, SolveOptions())
    constraints = constraints_given(arguments)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        problem = with_rigs(load(source, progress.text), arguments.rig_config)
        place, lost = placed(source)
        known = priors_given(arguments, problem)
        progress.stage(f"writing {shown(page)}")
        with naming_flags(**NAMED, priors=main_flag(arguments)):
            notes = write_report(
                problem,
                page,
                images=arguments.images,
                georeference=place,
                priors=() if known is None else known.priors,
                constraints=constraints,
                name=str(source),
            )
        notes = (*lost, *notes)
    wall = perf_counter() - started
    publish(reported(source, problem, page, notes, wall), arguments.json)
    return EXIT_DONE
