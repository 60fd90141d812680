"""`bundle vio`."""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter

import numpy as np

from bundle.base.paths import as_path
from bundle.base.waiting_time import Waiting, waiting_since
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.cli.sequence_commands import given_sequence
from bundle.cli.standard_streams import complain
from bundle.errors import InputError, shown
from bundle.inertial.tracking.sequence_axes import explanations
from bundle.inertial.two_loops.closure_loop import load_closures
from bundle.inertial.two_loops.replay import TwoLoopsResult, run_two_loops
from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.odometry import OdometryResult, run_odometry
from bundle.inertial.vio.trajectory_comparison import compare_trajectories, covered_by
from bundle.inertial.vio.window_alarms import DISAGREEMENT
from bundle.interface.window_options import WindowOptions
from bundle.io.atomic import atomic_write as atomic
from bundle.io.recognition import sequence_format
from bundle.io.sequences.trajectory_files import load_trajectory, save_tum
from bundle.model.sequence.sequence import Sequence
from bundle.reports.terminal.vio import odometry_report, telemetry_lines, with_loops


def run(arguments: argparse.Namespace) -> int:
    """Run the odometry over SEQUENCE."""
    started = perf_counter()

    source, target = arguments.sequence, arguments.output
    if arguments.publish is None and (arguments.loops is not None or arguments.real_time):
        flag = "--real-time" if arguments.loops is None else "--loops"
        raise InputError(f"{flag}: expected --publish FILE.tum, too")
    options = options_given(arguments, WindowOptions)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        given = given_sequence(source, arguments, progress)
        sequence = given.sequence
        given.refuse_fatal()
        truth = None
        if arguments.ground_truth is not None:
            truth = load_trajectory(arguments.ground_truth)
            covered_by(truth, np.unique(sequence.image_timestamps_ns))
        progress.stage("following the motion")

        def shown_keyframe(done: int, count: int, record: KeyframeRecord | None) -> bool:
            if record is not None and len(record.alarms) > 0 and progress.is_live:
                progress.stage(f"image {done} of {count}: {record.alarms[0]}")
            return True

        before = Waiting.now()
        with naming_flags(WindowOptions):
            if arguments.publish is None:
                loops, result = None, run_odometry(sequence, options, progress=shown_keyframe)
            else:
                loops = _replayed(arguments, sequence, options)
                result = loops.odometry
        waiting = waiting_since(before)
        error = None if truth is None else compare_trajectories(result.trajectory, truth)
        corrected = None
        if truth is not None and loops is not None:
            corrected = compare_trajectories(loops.published, truth)
        findings = given.findings
        if given.tracking is None and (not result.is_usable or _disagrees(result)):
            progress.stage("searching the cause")
            findings = (*findings, *explanations(sequence, source))
        progress.stage(f"writing {shown(target)}")
        save_tum(target, result.trajectory.timestamps_ns, result.trajectory.states)
        if loops is not None and result.is_usable:
            published = loops.published
            save_tum(arguments.publish, published.timestamps_ns, published.states)
        if arguments.telemetry is not None:
            atomic.write_text(as_path(arguments.telemetry), telemetry_lines(result))
        if arguments.html is not None:
            from bundle.reports.page.odometry_page import write_odometry  # for --html only

            progress.stage(f"writing {shown(arguments.html)}")
            write_odometry(result, arguments.html, truth=truth, error=error, name=Path(source).name)
    wall = perf_counter() - started
    report = odometry_report(
        source,
        sequence_format(source),
        sequence,
        result,
        error,
        target,
        wall,
        findings,
        waiting,
        given.tracking,
    )
    if loops is not None:
        path = arguments.publish if result.is_usable else None
        report = with_loops(report, loops, corrected, path)
    publish(report, arguments)
    if result.is_usable and not result.interrupted:
        return EXIT_DONE
    if arguments.json == "-":
        complain(result.message)
    return EXIT_NO_SOLUTION


def _disagrees(result: OdometryResult) -> bool:
    return any(DISAGREEMENT in alarm for each in result.keyframes for alarm in each.alarms)


def _replayed(
    arguments: argparse.Namespace, sequence: Sequence, options: WindowOptions
) -> TwoLoopsResult:

    closures = () if arguments.loops is None else load_closures(arguments.loops)
    return run_two_loops(sequence, options, closures=closures, real_time=arguments.real_time)
