"""`bundle report`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from bundle.analysis.statistics.description import describe
from bundle.analysis.uncertainty.covariance_by_input import covariance
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.georeference_flags import (
    GEOREFERENCE_FLAGS,
    georeference_given,
    main_flag,
    priors_of,
)
from bundle.cli.next_run import repeated_flags
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.cli.problem_edits import rules_of, with_rigs
from bundle.cli.progress import Progress
from bundle.errors import InputError, shown
from bundle.interface.camera_edit_options import RuleOptions
from bundle.interface.finding import one_list
from bundle.interface.options import SolveOptions
from bundle.io.georeference_file import owner_of, path_beside
from bundle.io.open import load
from bundle.judging.findings.find import find
from bundle.reports.page.report_page import write_report
from bundle.reports.terminal.report import reported

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.covariance_result import Covariance
    from bundle.model.problem import Problem
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.placed_problem import Prior


def placed(source: str) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """Return the content of the georeference.json that `bundle refine` wrote, if it exists.

    Returns:
        The content, or None without a file; and a sentence if the file has other content.
    """
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


def _covariance(
    problem: Problem, priors: Sequence[Prior], constraints: Constraints | tuple[()]
) -> Covariance | None:
    """Return the covariance; None if it does not exist, as the page explains."""
    try:
        return covariance(problem, priors=priors, constraints=constraints, scale="sigma0")
    except InputError:
        return None


def run(arguments: argparse.Namespace) -> int:
    """Write the report page of INPUT."""
    started = perf_counter()
    source, page = arguments.input, arguments.output
    if page == "-":
        raise InputError("--output: expected a file for the page, found -")
    given = georeference_given(arguments, SolveOptions().refine, page=True)
    constraints = rules_of(options_given(arguments, RuleOptions))
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        problem = with_rigs(load(source, progress.text), arguments.rig_config)
        place, lost = placed(source)
        known = priors_of(given, problem)
        priors = () if known is None else known.priors
        with naming_flags(**GEOREFERENCE_FLAGS, priors=main_flag(given)):
            progress.stage("computing the covariance")
            certainty = _covariance(problem, priors, constraints)
            progress.stage("judging")
            found = one_list(
                describe(problem).suspicions,
                find(
                    problem,
                    source=source,
                    given=repeated_flags(arguments),
                    covariance=certainty,
                    priors=priors,
                    constraints=constraints,
                ),
            )
            progress.stage(f"writing {shown(page)}")
            notes = write_report(
                problem,
                page,
                images=arguments.images,
                georeference=place,
                covariance=certainty,
                priors=priors,
                constraints=constraints,
                findings=found,
                name=str(source),
            )
        notes = (*lost, *notes)
    wall = perf_counter() - started
    publish(reported(source, problem, page, notes, wall, found), arguments)
    return EXIT_DONE
