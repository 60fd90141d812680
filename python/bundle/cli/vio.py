"""`bundle vio`."""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.option_flags import add_options, naming_flags, options_given
from bundle.cli.path_checks import (
    a_path,
    page_path,
    reconstruction,
    telemetry_path,
    trajectory_path,
)
from bundle.interface.window_options import WindowOptions

if TYPE_CHECKING:
    from bundle.inertial.two_loops.replay import TwoLoopsResult
    from bundle.inertial.vio.keyframe_record import KeyframeRecord
    from bundle.model.sequence.sequence import Sequence

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "vio"
HELP = "visual-inertial odometry from feature tracks and IMU samples"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle vio SEQUENCE -o FILE.tum [options]"
    parser.add_argument(
        "sequence",
        metavar="SEQUENCE",
        type=reconstruction,
        help="a folder with imu.csv, tracks.csv and calibration.yaml, or a table of both that "
        "bundle convert reads",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE.tum",
        type=trajectory_path,
        required=True,
        help="poses world_from_imu of the images that were solved for, a line each: timestamp in "
        "seconds, tx ty tz, qx qy qz qw; z is up",
    )
    parser.add_argument(
        "--ground-truth",
        metavar="FILE",
        type=a_path,
        help="compare with it: EuRoC's csv or a TUM file (needs evo)",
    )
    parser.add_argument(
        "--telemetry",
        metavar="FILE.jsonl",
        type=telemetry_path,
        help="one line of JSON per keyframe, as it is settled",
    )
    parser.add_argument(
        "--html",
        metavar="PAGE",
        type=page_path(),
        help="a page with the curves of the telemetry and the path, a single file",
    )
    loops = parser.add_argument_group("two loops")
    loops.add_argument(
        "--publish",
        metavar="FILE.tum",
        type=trajectory_path,
        help="a pose per IMU sample: the window's last solution, propagated, and moved by what "
        "closures correct",
    )
    loops.add_argument(
        "--loops",
        metavar="FILE",
        type=a_path,
        help="closures: csv of first_timestamp_ns, second_timestamp_ns, tx ty tz, qx qy qz qw of "
        "the IMU at the second time in its frame at the first, sigmas in metres and degrees; or a "
        "g2o file whose ids are the stamps",
    )
    loops.add_argument(
        "--real-time",
        action="store_true",
        help="replay at the rate of the sensors and report how late the poses are",
    )
    add_options(parser, WindowOptions, "the window")


def run(arguments: argparse.Namespace) -> int:
    """Run the odometry over SEQUENCE."""
    started = perf_counter()
    import numpy as np

    from bundle.base.paths import as_path
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.cli.standard_streams import complain
    from bundle.errors import InputError, shown
    from bundle.inertial.vio.odometry import run_odometry
    from bundle.inertial.vio.trajectory_comparison import compare_trajectories, covered_by
    from bundle.io.atomic import atomic_write as atomic
    from bundle.io.recognition import sequence_format
    from bundle.io.sequences.sequence_folder import read_sequence, refuse_fatal
    from bundle.io.sequences.trajectory_files import load_trajectory, save_tum
    from bundle.reports.terminal.vio import odometry_report, telemetry_lines

    source, target = arguments.sequence, arguments.output
    if arguments.publish is None and (arguments.loops is not None or arguments.real_time):
        flag = "--real-time" if arguments.loops is None else "--loops"
        raise InputError(f"{flag}: expected --publish FILE.tum with it, found none")
    options = options_given(arguments, WindowOptions)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        sequence, findings = read_sequence(source)
        refuse_fatal(findings)
        truth = None
        if arguments.ground_truth is not None:
            truth = load_trajectory(arguments.ground_truth)
            covered_by(truth, np.unique(sequence.image_timestamps_ns))
        progress.stage("following the motion")

        def shown_keyframe(done: int, count: int, record: KeyframeRecord | None) -> bool:
            if record is not None and len(record.alarms) > 0 and progress.is_live:
                progress.stage(f"image {done} of {count}: {record.alarms[0]}")
            return True

        with naming_flags(WindowOptions):
            if arguments.publish is None:
                loops, result = None, run_odometry(sequence, options, progress=shown_keyframe)
            else:
                loops = _replayed(arguments, sequence, options)
                result = loops.odometry
        error = None if truth is None else compare_trajectories(result.trajectory, truth)
        corrected = None
        if truth is not None and loops is not None:
            corrected = compare_trajectories(loops.published, truth)
        if result.is_usable:
            progress.stage(f"writing {shown(target)}")
            save_tum(target, result.trajectory.timestamps_ns, result.trajectory.states)
            if loops is not None:
                published = loops.published
                save_tum(arguments.publish, published.timestamps_ns, published.states)
        if arguments.telemetry is not None:
            atomic.write_text(as_path(arguments.telemetry), telemetry_lines(result))
        if arguments.html is not None:
            from bundle.reports.page.odometry_page import write_odometry

            progress.stage(f"writing {shown(arguments.html)}")
            write_odometry(result, arguments.html, truth=truth, error=error, name=Path(source).name)
    wall = perf_counter() - started
    written = target if result.is_usable else None
    report = odometry_report(
        source, sequence_format(source), sequence, result, error, written, wall, findings
    )
    if loops is not None:
        from bundle.reports.terminal.two_loops_tables import with_loops

        path = arguments.publish if result.is_usable else None
        report = with_loops(report, loops, corrected, path)
    publish(report, arguments.json)
    if result.is_usable and not result.interrupted:
        return EXIT_DONE
    if arguments.json == "-":
        complain(result.message)
    return EXIT_NO_SOLUTION


def _replayed(
    arguments: argparse.Namespace, sequence: Sequence, options: WindowOptions
) -> TwoLoopsResult:
    from bundle.inertial.two_loops.closure_files import load_closures
    from bundle.inertial.two_loops.replay import run_two_loops

    closures = () if arguments.loops is None else load_closures(arguments.loops)
    return run_two_loops(sequence, options, closures=closures, real_time=arguments.real_time)
