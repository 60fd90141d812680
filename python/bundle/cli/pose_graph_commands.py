"""`bundle refine`, `info` and `convert` of a pose graph."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from bundle.base.waiting_time import Waiting, waiting_since
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.many_processes import note_alone
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_replaced, publish
from bundle.cli.progress import Progress
from bundle.cli.standard_streams import complain
from bundle.errors import shown
from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.g2o_files import check_g2o_target, load_g2o, save_g2o
from bundle.reports.sections import Report
from bundle.reports.terminal.convert import converted_graph
from bundle.reports.terminal.pose_graph_tables import described_graph, refined_graph
from bundle.reports.terminal.solve_data import WallTime

if TYPE_CHECKING:
    from bundle.model.pose_graph_arrays import PoseGraph


def refine(arguments: argparse.Namespace) -> int:
    """Refine the pose graph INPUT into OUTPUT."""
    note_alone("refines the pose graph")
    started = perf_counter()
    refuse_flags_of_reconstructions(arguments, (*PoseGraphOptions.names(), "html"))
    options = options_given(arguments, PoseGraphOptions)
    source, target = arguments.input, arguments.output
    check_g2o_target(target)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        begun = perf_counter()
        graph = load_g2o(source)
        load_time = perf_counter() - begun
        check_replaced(target, [source], arguments.overwrite, partial(_has_same_poses, graph))
        progress.stage("building the problem")
        before = Waiting.now()
        with naming_flags(PoseGraphOptions):
            solved = solve_pose_graph(graph, options, progress=progress.iteration)
        waiting = waiting_since(before)
        begun = perf_counter()
        saved = solved.summary.is_solution_usable or solved.summary.interrupted
        if saved:
            progress.stage(f"writing {shown(target)}")
            save_g2o(solved.problem, target)
        save_time = perf_counter() - begun
        if arguments.html is not None:
            from bundle.reports.page.graph_report import write_graph_report  # only for --html

            progress.stage(f"writing {shown(arguments.html)}")
            write_graph_report(solved, arguments.html, name=str(source))
    wall = WallTime(
        load=load_time,
        build=solved.build_time_in_seconds,
        solve=solved.solve_time_in_seconds,
        save=save_time,
        total=perf_counter() - started,
    )
    written = {"path": target, "format": "g2o"} if saved else None
    publish(refined_graph(source, solved, wall, written, waiting), arguments)
    if solved.summary.is_solution_usable and not solved.summary.interrupted:
        return EXIT_DONE
    if arguments.json == "-":
        complain(solved.outcome)
    return EXIT_NO_SOLUTION


def describe(path: str, arguments: argparse.Namespace, _progress: Progress) -> Report:
    """Return the report of `bundle info` on a pose graph."""
    refuse_flags_of_reconstructions(arguments)
    return described_graph(path, load_g2o(path))


def convert(arguments: argparse.Namespace) -> int:
    """Write the pose graph INPUT with or without compression; compute missing poses."""
    refuse_flags_of_reconstructions(arguments)
    path = arguments.output
    check_g2o_target(path)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        graph = load_g2o(arguments.input)
        same = partial(_has_same_poses, graph)
        check_replaced(path, [arguments.input], arguments.overwrite, same)
        progress.stage(f"writing {shown(path)}")
        lost = save_g2o(graph, path)
    output = {"path": path, "format": "g2o"}
    publish(converted_graph(arguments.input, graph, output, lost), arguments)
    return EXIT_DONE


def _has_same_poses(graph: PoseGraph, path: Path) -> bool:
    """Tell whether a pose graph file has poses with the same ids."""
    there = load_g2o(path)
    return there.poses.shape == graph.poses.shape and sorted(there.ids) == sorted(graph.ids)
