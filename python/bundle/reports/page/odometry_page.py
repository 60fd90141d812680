"""Page of an odometry: telemetry of the keyframes over time, and the path from above."""

from __future__ import annotations

import os

from bundle.base.arrays import check_type
from bundle.base.paths import as_path
from bundle.figures.odometry_figures import odometry_figures
from bundle.inertial.vio.keyframe_record import alarms_by_kind
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.reports.page.page import write_page
from bundle.reports.page.table import rendered
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.vio import odometry_facts

SECTIONS = {
    "Trajectory": ("path", "error"),
    "Work": ("times", "steps", "costs", "sizes", "fill"),
    "State of the window": (
        "nullity",
        "excitation",
        "imu_excess",
        "yaw_sigma",
        "spectrum",
        "prior",
    ),
    "Biases": ("gyro_bias", "accel_bias"),
    "Marginalization": ("ages", "landmarks_left"),
}
ROWS = 12


def write_odometry(
    result: OdometryResult,
    path: str | os.PathLike[str],
    *,
    truth: Trajectory | None = None,
    error: TrajectoryError | None = None,
    name: str = "",
) -> None:
    """Write one self-contained HTML page about an odometry.

    Args:
        result: result of :func:`bundle.run_odometry`.
        path: path of the page. A failed write leaves no partial file.
        truth: true trajectory, drawn together with the estimate.
        error: error of :func:`bundle.inertial.vio.trajectory_comparison.compare_trajectories`, for
            the table.
        name: name of the sequence, for the title.

    Raises:
        InputError: ``result`` is not an odometry result, the truth has fewer than three poses in
            common with the trajectory, or the path cannot hold a page.
        OSError: the page cannot be written.
    """
    check_type("result", result, OdometryResult)
    check_type("name", name, str)
    figures = {figure.name: figure for figure in odometry_figures(result, truth)}
    facts = [("result", result.message), *odometry_facts(name, result, error)]
    sections = [Section(facts=facts), _alarms(result)]
    for title, names in SECTIONS.items():
        drawn = [figures[key].figure() for key in names if key in figures]
        sections.append(Section(title=title, figures=drawn))
    title = f"Odometry of {name}" if name else "Odometry"
    data = {"figures": [figure.asdict() for figure in figures.values()]}
    write_page(as_path(path), title, rendered(sections), data, script="")


def _alarms(result: OdometryResult) -> Section:
    """Return each kind of alarm once, with the keyframes that raised it."""
    begin = int(result.trajectory.timestamps_ns[0])
    found = alarms_by_kind(result.keyframes)
    if not found:
        return Section(title="Alarms", text=["None."])
    rows = []
    for raised in found.values():
        first, last = (f"{1e-9 * (raised[k][0] - begin):.2f}" for k in (0, -1))
        rows.append([raised[0][1], f"{len(raised)}", first, last])
    head = ["alarm", "keyframes", "first [s]", "last [s]"]
    return Section(title="Alarms", tables=[Table.of(head, rows, most=ROWS)])
