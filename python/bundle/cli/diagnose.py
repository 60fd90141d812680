"""`bundle diagnose` of a reconstruction."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.analysis.diagnosis.diagnose_problem import diagnose
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_graphs
from bundle.cli.georeference_flags import (
    GEOREFERENCE_FLAGS,
    georeference_given,
    main_flag,
    priors_of,
)
from bundle.cli.next_run import repeated_flags
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.cli.output import publish
from bundle.cli.problem_edits import rules_as_options, rules_of, with_rigs
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.camera_edit_options import RuleOptions
from bundle.interface.options import LINEARIZATION, SolveOptions
from bundle.io.open import load
from bundle.judging.findings.find import find
from bundle.reports.terminal.diagnose import diagnosed


def run(arguments: argparse.Namespace) -> int:
    """Diagnose INPUT."""
    started = perf_counter()
    refuse_flags_of_graphs(arguments)
    options = options_given(arguments, SolveOptions, names_follow=True)
    georeference = georeference_given(arguments, options.refine)
    rules = options_given(arguments, RuleOptions)
    constraints = rules_of(rules)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = with_rigs(load(arguments.input, progress.text), arguments.rig_config)
        options = with_named_images(options, arguments.fixed_image_ids, problem)
        known = priors_of(georeference, problem)
        progress.stage("diagnosing")
        with naming_flags(SolveOptions, **GEOREFERENCE_FLAGS, priors=main_flag(georeference)):
            diagnosis = diagnose(
                problem,
                options,
                priors=() if known is None else known.priors,
                constraints=constraints,
            )
        progress.stage("judging")
        found = find(
            problem,
            source=arguments.input,
            given=repeated_flags(arguments),
            options=options,
            priors=() if known is None else known.priors,
            constraints=constraints,
        )
    asked = {name: getattr(options, name) for name in LINEARIZATION} | rules_as_options(rules)
    wall = perf_counter() - started
    publish(diagnosed(arguments.input, problem, diagnosis, asked, wall, found), arguments)
    return EXIT_DONE
