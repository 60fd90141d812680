"""Positions against velocities and time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bundle.inertial.vio.window_run import PathSanity
from bundle.io.sequences.trajectory_files import Trajectory

TENTH = 10**8


def walk(speed: float = 1.5, steps: int = 100) -> Any:
    states = np.zeros((steps, 16))
    states[:, 3] = 1.0
    states[:, 7] = speed
    states[:, 4] = 0.1 * speed * np.arange(steps)
    return states


def judged(states: Any) -> list[str]:
    sanity = PathSanity(0, states[0])
    return [sanity.objection(TENTH * k, state) for k, state in enumerate(states) if k]


@pytest.mark.parametrize("speed", [0.0, 1.5, 30.0, 300.0])
def test_a_path_that_follows_its_velocities_is_one(speed: float) -> None:
    assert not any(judged(walk(speed)))


@pytest.mark.parametrize(
    ("speed", "jump", "is_lost"), [(1.5, 26.0, True), (1.5, 1.5, False), (1.5, 2.0, True),
                                   (30.0, 15.0, False), (30.0, 17.0, True)],
)  # fmt: skip
def test_a_jump_is_measured_by_the_speed(speed: float, jump: float, is_lost: bool) -> None:
    states = walk(speed)
    states[50:, 5] += jump
    assert [bool(text) for text in judged(states)][49] == is_lost


@pytest.mark.parametrize("speeds", [(1.5, 30.0), (30.0, 1.5)])
def test_the_larger_speed_of_both_states_counts(speeds: tuple[float, float]) -> None:
    states = walk(speeds[0], 1000)
    states[990:, 7] = speeds[1]
    states[990:, 4] += 0.05 * (speeds[1] - speeds[0]) + 14.0
    states[990:, 4] += 0.1 * (speeds[1] - speeds[0]) * np.arange(10)
    assert not any(judged(states))
    states[990:, 4] += 3.0
    assert "jump" in judged(states)[989]


def test_small_steps_add_up() -> None:
    """A metre a second, sideways, at 1.5 m/s: each step is below what a jump is."""
    states = walk()
    states[:, 6] += 0.1 * np.arange(len(states))
    said = judged(states)
    assert not any(said[:20])
    assert said[-1] and "jump" not in said[-1]


@pytest.mark.parametrize(
    ("column", "good", "bad", "word"),
    [
        (10, 0.99, 1.01, "gyroscope"),
        (14, 4.99, 5.01, "accelerometer"),
        (8, 339.0, 341.0, "speed"),
        (5, 0.0, np.nan, "finite"),
    ],
)
def test_states_that_no_sensor_has(column: int, good: float, bad: float, word: str) -> None:
    for value, expected in ((good, False), (-good, False), (bad, True), (-bad, True)):
        states = walk(0.0, 3)
        states[2, column] = value
        said = judged(states)[-1]
        assert (word in said) == expected


def test_a_real_truth_is_a_path(bundle_data: Any) -> None:
    from bundle.io.sequences.trajectory_files import load_ground_truth

    truth: Trajectory = load_ground_truth(bundle_data / "vio" / "euroc_V1_01_ground_truth.csv")
    sanity = PathSanity(int(truth.timestamps_ns[0]), truth.states[0])
    rows = range(20, len(truth), 20)
    assert not any(sanity.objection(int(truth.timestamps_ns[k]), truth.states[k]) for k in rows)
