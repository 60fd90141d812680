"""`bundle validate` of reconstructions."""

from __future__ import annotations

import argparse
import shlex
from typing import Any

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.georeference_flags import (
    GEOREFERENCE_FLAGS,
    georeference_given,
    main_flag,
    priors_of,
)
from bundle.cli.option_flags import flags_of, naming_flags, options_given, with_named_images
from bundle.cli.output import publish
from bundle.cli.problem_edits import rules_as_options, rules_of, with_rigs
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.camera_edit_options import RuleOptions
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.judging_options import ValidationOptions
from bundle.interface.options import SolveOptions
from bundle.io.open import load
from bundle.judging.validation.validate_problem import validate
from bundle.reports.terminal.validate import validated


def run(arguments: argparse.Namespace) -> int:
    """Validate candidates for INPUT."""
    source = arguments.input
    asked = options_given(arguments, ValidationOptions)
    options = options_given(arguments, SolveOptions, names_follow=True)
    georeference = georeference_given(arguments, options.refine)
    rules = options_given(arguments, RuleOptions)
    constraints = rules_of(rules)
    flags = {**flags_of(ValidationOptions), **GEOREFERENCE_FLAGS, "priors": main_flag(georeference)}
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        problem = with_rigs(load(source, progress.text), arguments.rig_config)
        options = with_named_images(options, arguments.fixed_image_ids, problem)
        known = priors_of(georeference, problem)
        progress.stage("fitting the candidates")
        with naming_flags(SolveOptions, **flags, refine="--refine"):
            found = validate(
                problem,
                options,
                num_folds=asked.num_folds,
                seed=asked.seed,
                camera_models=asked.camera_models or (),
                share=asked.share or (),
                losses=asked.losses or (),
                refine_sets=asked.refined,
                priors=() if known is None else known.priors,
                constraints=tuple(constraints),
                source=source,
                flags=_beside(arguments, georeference, rules),
                progress=lambda done, count, _: progress.share(done / count),
            )
    settings = {**options.asdict(), **rules_as_options(rules), **georeference.changed()}
    publish(validated(source, problem, found, settings), arguments)
    return EXIT_DONE


def _beside(
    arguments: argparse.Namespace, georeference: GeoreferenceOptions, rules: RuleOptions
) -> str:
    """Return the flags of rigs, positions, control points and rules, for `bundle refine`."""
    words: list[str] = []
    if arguments.rig_config is not None:
        words += ["--rig-config", arguments.rig_config]
    names: dict[str, Any] = {**flags_of(GeoreferenceOptions), **flags_of(RuleOptions)}
    for name, value in {**georeference.changed(), **rules.changed()}.items():
        for one in value if isinstance(value, tuple | list) else (value,):
            words += [names[name], str(one)]
    return shlex.join(words)
