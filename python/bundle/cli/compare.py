"""`bundle compare`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.option_flags import add_options, naming_flags, options_given
from bundle.cli.path_checks import page_path, reconstruction
from bundle.cli.pose_graph_flags import add_pose_graph_flags, refuse_flags_of_graphs
from bundle.errors import InputError
from bundle.interface import compare_defaults as defaults
from bundle.interface.options import SolveOptions
from bundle.io.recognition import is_pose_graph_file

if TYPE_CHECKING:
    from bundle.cli.progress import Progress
    from bundle.planning.comparison import work
    from bundle.planning.comparison.comparison_result import Comparison

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "compare"
GRAPH_OPTIONS = ("error", "init", "information", "loss", "loss_on")
HELP = "the same start under several solvers: measured, and one of them recommended"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle compare INPUT... [options]"
    parser.add_argument(
        "inputs",
        metavar="INPUT",
        type=reconstruction,
        nargs="+",
        help="BAL files (plain, .gz or .bz2) and folders of COLMAP models; several give "
        "performance profiles as well; or one pose graph (g2o)",
    )
    _add_methods(parser.add_argument_group("what is compared: every combination of"))
    _add_limits(parser.add_argument_group("options of the comparison"))
    others = [name for name in SolveOptions.__dataclass_fields__ if name not in defaults.COMPARED]
    add_options(parser, SolveOptions, "options of every solve", others)
    add_pose_graph_flags(
        parser, GRAPH_OPTIONS, "a pose graph (.g2o), of which backends and threads are compared too"
    )


def _add_methods(group: argparse._ArgumentGroup) -> None:
    fields = SolveOptions.__dataclass_fields__
    for name, values, words in (
        ("linear_solver_type", defaults.SOLVERS, ""),
        ("backend", defaults.BACKENDS, ""),
        ("preconditioner_type", defaults.PRECONDITIONERS, "for iterative solvers, "),
        ("linear_solver_ordering", defaults.ORDERINGS, "which blocks are eliminated first, "),
    ):
        choices = ", ".join(fields[name].metadata["choices"]).replace("_", "-")
        shown = ",".join(values).replace("_", "-")
        group.add_argument(
            _flag(name),
            metavar="LIST",
            type=_names,
            default=values,
            help=f"{words}out of {choices} (default: {shown})",
        )
    group.add_argument(
        "--threads",
        metavar="LIST",
        type=_counts,
        default=defaults.THREADS,
        help="numbers of threads, such as 1,2; 0: all cores "
        f"(default: {','.join(map(str, defaults.THREADS))})",
    )


def _add_limits(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--repeat",
        metavar="N",
        type=int,
        default=defaults.REPEAT,
        help="runs of each method, of which the median counts; a run of more than "
        f"{defaults.SECONDS_NOT_REPEATED:g} s is not repeated (default: {defaults.REPEAT})",
    )
    group.add_argument(
        "--timeout",
        metavar="SECONDS",
        type=float,
        default=defaults.TIMEOUT,
        help=f"stop a solve that takes longer (default: {defaults.TIMEOUT:g})",
    )
    group.add_argument(
        "--memory-cap",
        metavar="SIZE",
        help="stop a solve that takes more memory beyond the loaded problem, such as 500MB; "
        "1 MB is 1,000,000 bytes "
        f"(default: {100 * defaults.SHARE_OF_FREE_MEMORY:g} %% of what is free at the start)",
    )
    group.add_argument(
        "--html", metavar="FILE", type=page_path(), help="also write a page with plots"
    )


def run(arguments: argparse.Namespace) -> int:
    """Compare methods on INPUT: 0 if one can be recommended."""
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.planning.comparison.compare_methods import compare
    from bundle.reports.terminal.compare import compared

    if any(is_pose_graph_file(path) for path in arguments.inputs):
        from bundle.cli.pose_graph_costs import compare_graph_file

        return compare_graph_file(arguments)
    refuse_flags_of_graphs(arguments)
    options = options_given(arguments, SolveOptions)
    cap = _memory_cap(arguments.memory_cap)
    if arguments.repeat < 1:
        raise InputError(f"--repeat: expected at least 1, found {arguments.repeat}")
    if not arguments.timeout > 0:
        raise InputError(f"--timeout: expected more than 0 seconds, found {arguments.timeout:g}")
    flags = {name: _flag(name) for name in defaults.COMPARED}
    with Progress(quiet=arguments.quiet) as progress, naming_flags(**flags):
        comparison = compare(
            arguments.inputs,
            options,
            solvers=arguments.solvers,
            preconditioners=arguments.preconditioners,
            orderings=arguments.orderings,
            backends=arguments.backends,
            threads=arguments.threads,
            repeat=arguments.repeat,
            timeout=arguments.timeout,
            memory_cap=cap,
            progress=lambda at: _show_progress(progress, at),
        )
        if arguments.html is not None:
            _write_page(comparison, arguments.html, progress)
    publish(compared(comparison), arguments.json)
    if comparison.recommendation is None or comparison.interrupted:
        return EXIT_NO_SOLUTION
    return EXIT_DONE


def _write_page(compared: Comparison, path: str, progress: Progress) -> None:
    from bundle.errors import shown
    from bundle.reports.page.comparison_page import write_comparison

    progress.stage(f"writing {shown(path)}")
    write_comparison(compared, path)


def _show_progress(progress: Progress, at: work.Progress) -> None:
    if at.iteration is None:
        progress.stage(at.stage)
    elif progress.is_live:
        values = at.iteration
        progress.stage(f"{at.stage}: iter {values['iteration']}  cost {values['cost']:.4e}")


def _flag(name: str) -> str:
    """Return the flag that lists the values of an option that is compared."""
    return f"--{defaults.COMPARED[name]}"


def _memory_cap(text: str | None) -> int:
    from bundle.base.memory_sizes import parse_size

    try:
        return 0 if text is None else parse_size(text)
    except InputError as error:
        raise InputError(f"--memory-cap: {error}") from None


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _counts(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdigit() and len(part) < 9 for part in parts):
        raise argparse.ArgumentTypeError(f"expected numbers such as 1,2, found {text!r}")
    return tuple(map(int, parts))
