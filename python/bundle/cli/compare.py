"""`bundle compare` of reconstructions."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.flags_by_kind import refuse_flags_of_graphs
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.interface.options import ORDERINGS, SolveOptions
from bundle.interface.planning_options import COMPARED, CompareOptions
from bundle.planning.comparison.compare_methods import compare
from bundle.reports.terminal.compare import compared

if TYPE_CHECKING:
    from bundle.planning.comparison import work


def run(arguments: argparse.Namespace) -> int:
    """Compare methods on INPUT; return 0 if one has a usable solution."""
    refuse_flags_of_graphs(arguments)
    options = options_given(arguments, SolveOptions)
    asked = options_given(arguments, CompareOptions)
    flags = {name: f"--{listed.replace('_', '-')}" for name, listed in COMPARED.items()}
    with Progress(quiet=arguments.quiet) as progress, naming_flags(**flags):
        comparison = compare(
            arguments.inputs,
            options,
            solvers=asked.solvers,
            preconditioners=asked.preconditioners,
            orderings=ORDERINGS if arguments.orders == "all" else asked.orderings,
            backends=asked.backends,
            trust_regions=asked.trust_regions,
            threads=asked.threads,
            perturb=asked.perturb,
            seed=asked.seed,
            repeat=asked.repeat,
            timeout=asked.timeout,
            memory_cap=asked.memory_cap_in_bytes,
            progress=lambda at: _show_progress(progress, at),
        )
    publish(compared(comparison), arguments)
    usable = any(run.is_usable for run in comparison.runs)
    return EXIT_DONE if usable and not comparison.interrupted else EXIT_NO_SOLUTION


def _show_progress(progress: Progress, at: work.Progress) -> None:
    if at.iteration is None:
        progress.stage(at.stage)
    elif progress.is_live:
        values = at.iteration
        progress.stage(f"{at.stage}: iter {values['iteration']}  cost {values['cost']:.4e}")
