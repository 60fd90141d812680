"""`bundle covariance` of a reconstruction."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.analysis.uncertainty.covariance_by_input import covariance
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_graphs
from bundle.cli.georeference_flags import (
    GEOREFERENCE_FLAGS,
    georeference_given,
    main_flag,
    priors_of,
)
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.cli.output import publish
from bundle.cli.problem_edits import rules_as_options, rules_of
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.analysis_options import CovarianceOptions
from bundle.interface.camera_edit_options import RuleOptions
from bundle.interface.options import INFORMATION, SolveOptions
from bundle.io.open import load
from bundle.reports.terminal.covariance import uncertainties

FLAGS = {name: f"--{name}" for name in ("of", "relative", "gauge", "scale", "robust")}
"""Flags of the arguments of :func:`bundle.covariance`."""


def run(arguments: argparse.Namespace) -> int:
    """Compute the covariances of INPUT."""
    started = perf_counter()
    refuse_flags_of_graphs(arguments)
    source, target = arguments.input, arguments.output
    wanted = options_given(arguments, CovarianceOptions)
    options = options_given(arguments, SolveOptions, names_follow=True)
    georeference = georeference_given(arguments, options.refine)
    rules = options_given(arguments, RuleOptions)
    constraints = rules_of(rules)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        problem = load(source, progress.text)
        options = with_named_images(options, arguments.fixed_image_ids, problem)
        known = priors_of(georeference, problem)
        progress.stage("inverting")
        flags = {**FLAGS, **GEOREFERENCE_FLAGS, "priors": main_flag(georeference)}
        with naming_flags(SolveOptions, **flags):
            found = covariance(
                problem,
                options,
                of=wanted.parts or "poses,points,intrinsics",
                relative=wanted.relative,
                gauge=wanted.covariance_gauge or "inner",
                scale=wanted.scale,
                robust=wanted.robust or "weights",
                priors=() if known is None else known.priors,
                constraints=constraints,
            )
        progress.stage(f"writing {shown(target)}")
        found.save(target)
    wall = perf_counter() - started
    asked = {name: getattr(options, name) for name in INFORMATION} | rules_as_options(rules)
    publish(uncertainties(source, problem, found, asked, target, wall), arguments)
    return EXIT_DONE
