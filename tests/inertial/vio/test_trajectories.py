"""Trajectories: files there and back, interpolation, comparison against evo and closed forms."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PosePath3D
from scipy.spatial.transform import Rotation, Slerp

import bundle
from bundle.inertial.vio.trajectory_comparison import (
    aligned_in_yaw,
    compare_trajectories,
    states_at,
)
from bundle.io.sequences.trajectory_files import (
    Trajectory,
    load_trajectory,
    load_tum,
    save_ground_truth,
    save_tum,
)
from tests.inertial.vio.sequences import START


def trajectory(size: int = 40) -> Trajectory:
    rng = np.random.default_rng(5)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.1, (size, 3)), axis=0))
    states = np.hstack([turns.as_quat(), np.cumsum(rng.normal(0, 0.3, (size, 12)), axis=0)])
    return Trajectory(START + 50_000_001 * np.arange(size), states)


def moved(given: Trajectory, turn: Rotation, shift: list[float], scale: float = 1) -> Trajectory:
    states = np.array(given.states)
    states[:, :4] = (turn * Rotation.from_quat(states[:, :4])).as_quat()
    states[:, 4:7] = scale * turn.apply(states[:, 4:7]) + shift
    return Trajectory(given.timestamps_ns, states)


def test_files_keep_nanoseconds_and_numbers(tmp_path: Path) -> None:
    given = trajectory()
    save_ground_truth(tmp_path / "g.csv", given.timestamps_ns, given.states)
    save_tum(tmp_path / "g.tum", given.timestamps_ns, given.states)
    for name, columns in (("g.csv", 16), ("g.tum", 7)):
        read = load_trajectory(tmp_path / name)
        np.testing.assert_array_equal(read.timestamps_ns, given.timestamps_ns)
        np.testing.assert_allclose(read.states[:, :columns], given.states[:, :columns], rtol=1e-15)
        assert np.isnan(read.states[:, columns:]).all()
    stamp, *numbers = (tmp_path / "g.tum").read_text().splitlines()[1].split()
    assert stamp == "1403715273.262142976"
    assert [float(number) for number in numbers] == given.states[0, [4, 5, 6, 0, 1, 2, 3]].tolist()
    euroc = (tmp_path / "g.csv").read_text().splitlines()[1].split(",")
    assert [float(word) for word in euroc[4:8]] == given.states[0, [3, 0, 1, 2]].tolist()


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("1 2 3", "8 columns"),
        ("x 0 0 0 0 0 0 1", "timestamp"),
        ("2 0 0 0 0 0 0 0", "norm 0"),
        ("2 0 nan 0 0 0 0 1", "finite"),
        ("1 0 0 0 0 0 0 1", "time goes back"),
    ],
)
def test_bad_lines_of_tum_files_are_named(tmp_path: Path, line: str, found: str) -> None:
    path = tmp_path / "a.tum"
    path.write_text(f"# a comment\n1 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(bundle.InputError, match=rf"a\.tum: line 3: .*{found}"):
        load_tum(path)
    path.write_text("# nothing\n")
    with pytest.raises(bundle.InputError, match="expected poses"):
        load_trajectory(path)


def test_states_are_interpolated_as_scipy_does() -> None:
    given = trajectory()
    stamps = np.sort(np.random.default_rng(1).integers(
        given.timestamps_ns[0], given.timestamps_ns[-1], 50
    ))  # fmt: skip
    found = states_at(given, stamps)
    times = given.timestamps_ns - START
    turns = Slerp(times, Rotation.from_quat(given.states[:, :4]))(stamps - START)
    difference = turns.inv() * Rotation.from_quat(found[:, :4])
    assert difference.magnitude().max() < 1e-12
    for column in range(4, 16):
        expected = np.interp(stamps - START, times, given.states[:, column])
        np.testing.assert_allclose(found[:, column], expected, atol=1e-12)


def test_alignments_take_away_what_is_free_and_nothing_else() -> None:
    truth = trajectory()
    same = compare_trajectories(moved(truth, Rotation.from_rotvec([0, 0, 2.0]), [3, 4, 5]), truth)
    assert max(same.ate, same.ate_yaw, same.rotation_rms) < 1e-6
    assert same.scale == pytest.approx(1, abs=1e-12)

    shrunk = compare_trajectories(moved(truth, Rotation.identity(), [0, 0, 0], 0.8), truth)
    assert shrunk.scale == pytest.approx(1.25, rel=1e-12)
    spread = truth.states[:, 4:7] - truth.states[:, 4:7].mean(axis=0)
    assert shrunk.ate == pytest.approx(0.2 * np.sqrt((spread**2).sum(1).mean()), rel=1e-12)

    tilted = compare_trajectories(moved(truth, Rotation.from_rotvec([0.1, 0, 0]), [0, 0, 0]), truth)
    assert tilted.ate < 1e-9
    assert tilted.ate_yaw > 0.01
    assert tilted.rotation_rms == pytest.approx(np.degrees(0.1), rel=0.2)
    length = np.linalg.norm(np.diff(truth.states[:, 4:7], axis=0), axis=1).sum()
    assert tilted.path_length == pytest.approx(length)


def test_noise_is_what_it_is_and_only_the_overlap_counts() -> None:
    truth = trajectory(2000)
    states = np.array(truth.states)
    states[:, 4:7] += np.random.default_rng(2).normal(0, 0.05, (2000, 3))
    error = compare_trajectories(Trajectory(truth.timestamps_ns, states), truth)
    assert error.ate == pytest.approx(0.05 * np.sqrt(3), rel=0.03)
    part = Trajectory(truth.timestamps_ns[:100], truth.states[:100])
    assert compare_trajectories(Trajectory(truth.timestamps_ns, states), part).num_poses == 100
    late = Trajectory(truth.timestamps_ns + 10**12, truth.states)
    with pytest.raises(bundle.InputError, match="ground truth"):
        compare_trajectories(late, truth)


def test_errors_are_those_of_evo() -> None:
    truth = trajectory(300)
    states = np.array(truth.states)
    rng = np.random.default_rng(5)
    states[:, 4:7] = 0.9 * states[:, 4:7] + rng.normal(0, 0.05, (300, 3))
    states[:, :4] = (
        Rotation.from_quat(states[:, :4]) * Rotation.from_rotvec([0.1, 0, 0])
    ).as_quat()
    estimate = Trajectory(truth.timestamps_ns, states)
    found = compare_trajectories(estimate, truth)

    def path(poses: np.ndarray) -> PosePath3D:
        return PosePath3D(
            positions_xyz=poses[:, 4:7], orientations_quat_wxyz=poses[:, [3, 0, 1, 2]]
        )

    def rms(poses: PosePath3D, relation: metrics.PoseRelation) -> float:
        error = metrics.APE(relation)
        error.process_data((path(truth.states), poses))
        return float(error.get_statistic(metrics.StatisticsType.rmse))

    position = metrics.PoseRelation.translation_part
    rigid = path(states)
    rigid.align(path(truth.states))
    assert found.ate == pytest.approx(rms(rigid, position), rel=1e-9)
    scale = path(states).align(path(truth.states), correct_scale=True)[2]
    assert found.scale == pytest.approx(scale, rel=1e-9)
    _, level, _ = aligned_in_yaw(estimate, truth)
    assert found.ate_yaw == pytest.approx(rms(path(level), position), rel=1e-9)
    angle = rms(path(level), metrics.PoseRelation.rotation_angle_deg)
    assert found.rotation_rms == pytest.approx(angle, rel=1e-9)


def test_an_estimate_that_stands_still_has_no_scale() -> None:
    truth = trajectory()
    states = np.array(truth.states)
    states[:, 4:7] = 0
    error = compare_trajectories(Trajectory(truth.timestamps_ns, states), truth)
    assert np.isnan(error.scale)
    assert error.ate == error.ate_yaw > 0


@pytest.mark.parametrize(
    ("stamp", "hint"),
    [
        ("1403715273262142976.000000", "nanoseconds"),
        ("1403715273262142976", "nanoseconds"),
        ("1.403715273262142976e+18", "nanoseconds"),
        ("1403715273262143.5", "microseconds"),
        ("1403715273262.1", "milliseconds"),
        ("+inf", "Inf|inf"),
        ("-inf", "inf"),
        ("inf", "inf"),
        ("nan", "nan"),
        ("-nan", "nan"),
        ("+Infinity", "Infinity"),
        ("9223372036.854775808", "seconds"),
        ("1e300", "1e300"),
    ],
)
@pytest.mark.parametrize("line", [2, 3])
def test_a_stamp_that_is_none_is_named(tmp_path: Path, stamp: str, hint: str, line: int) -> None:
    rows = ["# head", "1.0 0 0 0 0 0 0 1", "2.0 0 0 0 0 0 0 1", "3.0 0 0 0 0 0 0 1"]
    rows[line - 1] = f"{stamp} 0 0 0 0 0 0 1"
    path = tmp_path / "t.txt"
    path.write_text("\n".join(rows))
    with pytest.raises(bundle.InputError) as caught:
        load_tum(path)
    message = str(caught.value)
    assert f"{path}: line {line}: " in message and "\n" not in message
    if not (line == 2 and stamp in ("nan", "inf")):
        assert any(word in message for word in hint.split("|"))


def test_the_last_stamp_of_64_bits(tmp_path: Path) -> None:
    rows = [f"{stamp} 0 0 0 0 0 0 1" for stamp in ("9223372036.8", "9223372036.854775")]
    (tmp_path / "t.txt").write_text("\n".join(rows))
    stamps = load_tum(tmp_path / "t.txt").timestamps_ns
    np.testing.assert_array_equal(stamps, [9223372036800000000, 9223372036854775000])


@pytest.mark.parametrize("power", [-9, -6, -3, 3])
def test_a_truth_in_another_unit_is_named(power: int) -> None:
    given = trajectory()
    start = START if power < 0 else 10**14
    estimate = Trajectory(given.timestamps_ns - START + start, given.states)
    seconds = np.linspace(-2, 4, 40)
    stamps = np.rint((start + 1e9 * seconds) * 10.0**power) + np.arange(40)
    truth = Trajectory(stamps.astype(np.int64), given.states)
    with pytest.raises(bundle.InputError, match=re.escape(f"Multiplied by {10.0**-power:g},")):
        compare_trajectories(estimate, truth)
