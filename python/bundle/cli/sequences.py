"""Visual-inertial sequences: `bundle vio`, `info` and `convert`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bundle.cli.error_lines import EXIT_NO_SOLUTION
from bundle.cli.option_flags import naming_flags
from bundle.cli.output import check_replaced
from bundle.cli.run import Run, refuse_recording_flags
from bundle.errors import InputError, shown
from bundle.inertial.tracking.sequence_axes import axes_findings
from bundle.interface.finding import Finding
from bundle.interface.window_options import TrackingOptions
from bundle.io.recognition import is_recording, sequence_format
from bundle.io.sequences.sequence_folder import (
    check_sequence_target,
    read_sequence,
    refuse_fatal,
    save_sequence,
)
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding
from bundle.reports.sections import Report

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking
    from bundle.inertial.two_loops.replay import TwoLoopsResult
    from bundle.inertial.vio.keyframe_record import KeyframeRecord
    from bundle.inertial.vio.odometry import OdometryResult
    from bundle.interface.window_options import WindowOptions


def describe_sequence(run: Run) -> Report:
    """Describe the sequence INPUT."""
    from bundle.inertial.vio.odometry import sequence_statistics
    from bundle.reports.terminal.vio_reports import described_sequence

    given = given_sequence(run, run.source)
    statistics = sequence_statistics(given.sequence)
    format = sequence_format(run.source)
    return described_sequence(
        run.source, format, given.sequence, statistics, given.findings, given.tracking
    )


def convert_sequence(run: Run) -> Report:
    """Write the sequence INPUT as a folder."""
    from bundle.reports.terminal.vio_reports import converted_sequence

    source, target = run.source, run.target
    check_sequence_target(target)
    given = given_sequence(run, source)
    sequence = given.sequence

    def is_same(path: Path) -> bool:
        return np.array_equal(read_sequence(path)[0].frames()[0], sequence.frames()[0])

    check_replaced(target, [source], run.arguments.overwrite, is_same)
    run.write(target, lambda path: save_sequence(sequence, path))
    format = sequence_format(source)
    return converted_sequence(source, format, sequence, target, given.findings, given.tracking)


class GivenSequence(NamedTuple):
    """Sequence from the command line; ``tracking`` is None if the input has tracks."""

    sequence: Sequence
    findings: tuple[SequenceFinding | Finding, ...]
    tracking: Tracking | None

    def refuse_fatal(self) -> None:
        """Refuse a sequence on which odometry would fail."""
        for finding in self.findings:
            if isinstance(finding, Finding) and finding.is_problem:
                raise InputError(finding.sentence)
        refuse_fatal(each for each in self.findings if isinstance(each, SequenceFinding))


def given_sequence(run: Run, path: str) -> GivenSequence:
    """Read a sequence; track features if it has images."""
    arguments = run.arguments
    run.progress.stage(f"reading {shown(path)}")
    if not is_recording(path):
        refuse_recording_flags(arguments)
        sequence, findings = read_sequence(path)
        fatal = any(finding.is_fatal for finding in findings)
        axes = () if fatal else axes_findings(sequence, path)
        return GivenSequence(sequence, (*axes, *findings), None)
    from bundle.inertial.tracking.track_recording import track_images  # for images only

    run.progress.stage(f"tracking features of {shown(path)}")
    places = ("imu", "frame_times", "image_topic", "imu_topic")
    with naming_flags(TrackingOptions, **{name: arguments.flags[name] for name in places}):
        tracked = track_images(
            path,
            calibration=arguments.calibration or (),
            camera=arguments.camera or "cam0",
            options=run.given(TrackingOptions),
            progress=run.progress.share,
            **{name: getattr(arguments, name) for name in places},
        )
    return GivenSequence(tracked.sequence, tracked.findings, tracked.tracking)


def run_vio(run: Run) -> Report:
    """Run the odometry over SEQUENCE."""
    from bundle.base.own_process import Waiting, waiting_since
    from bundle.base.paths import as_path
    from bundle.inertial.tracking.sequence_axes import explanations
    from bundle.inertial.vio.odometry import run_odometry
    from bundle.inertial.vio.trajectory_comparison import compare_trajectories, covered_by
    from bundle.interface.window_options import WindowOptions
    from bundle.io.atomic import atomic_write as atomic
    from bundle.io.sequences.trajectory_files import load_trajectory, save_tum
    from bundle.reports.terminal.vio_reports import odometry_report, telemetry_lines, with_loops

    arguments, progress = run.arguments, run.progress
    source, target = arguments.sequence, run.target
    if arguments.publish is None and (arguments.loops is not None or arguments.real_time):
        flag = "--real-time" if arguments.loops is None else "--loops"
        raise InputError(f"{flag}: expected --publish FILE.tum, too")
    options = run.given(WindowOptions)
    given = given_sequence(run, source)
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
    if not result.is_usable or _disagrees(result):
        progress.stage("searching the cause")
        findings = (*findings, *explanations(sequence, source, findings))
    progress.stage(f"writing {shown(target)}")
    save_tum(target, result.trajectory.timestamps_ns, result.trajectory.states)
    if loops is not None and result.is_usable:
        save_tum(arguments.publish, loops.published.timestamps_ns, loops.published.states)
    if arguments.telemetry is not None:
        atomic.write_text(as_path(arguments.telemetry), telemetry_lines(result))
    run.page(
        "reports.page.result_pages:write_odometry",
        result,
        truth=truth,
        error=error,
        name=Path(source).name,
    )
    format = sequence_format(source)
    told = (source, format, sequence, result, error, target, run.wall, findings, waiting)
    report = odometry_report(*told, given.tracking)
    if loops is not None:
        path = arguments.publish if result.is_usable else None
        report = with_loops(report, loops, corrected, path)
    if not result.is_usable or result.interrupted:
        run.end(EXIT_NO_SOLUTION, result.message)
    return report


def _disagrees(result: OdometryResult) -> bool:
    from bundle.inertial.vio.window_alarms import DISAGREEMENT

    return any(DISAGREEMENT in alarm for each in result.keyframes for alarm in each.alarms)


def _replayed(
    arguments: argparse.Namespace, sequence: Sequence, options: WindowOptions
) -> TwoLoopsResult:
    from bundle.inertial.two_loops.closure_loop import load_closures
    from bundle.inertial.two_loops.replay import run_two_loops

    closures = () if arguments.loops is None else load_closures(arguments.loops)
    return run_two_loops(sequence, options, closures=closures, real_time=arguments.real_time)
