"""IMU samples that are no measurements, on both sides of each threshold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bundle.model.sequence.sequence_findings import _repeated, bad_stretches

Array = np.ndarray[Any, Any]
SIZE = 2000


def samples(seed: int = 0) -> tuple[Array, Array]:
    """Return rates and forces of a smooth motion with white noise."""
    rng = np.random.default_rng(seed)
    t = 5e-3 * np.arange(SIZE)[:, None]
    gyro = 0.5 * np.sin(t * [1.0, 1.3, 0.7]) + rng.normal(0, 3e-3, (SIZE, 3))
    accel = [0, 0, 9.81] + 2 * np.sin(t * [0.9, 1.7, 1.1]) + rng.normal(0, 0.03, (SIZE, 3))
    return gyro, accel


def found(gyro: Array, accel: Array) -> list[tuple[str, str, int, int]]:
    return [tuple(each[:4]) for each in bad_stretches(gyro, accel)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("every", [1, 4, 10])
def test_no_stretch_in_clean_samples_at_any_rate(seed: int, every: int) -> None:
    gyro, accel = samples(seed)
    assert found(gyro[::every], accel[::every]) == []


def test_a_repeated_sample_is_frozen_after_five() -> None:
    gyro, accel = samples()
    gyro[500:504] = gyro[500]
    assert found(gyro, accel) == []
    gyro[500:505] = gyro[500]
    accel[700:900] = 0.0
    assert found(gyro, accel) == [("frozen", "gyro", 500, 504), ("zero", "accel", 700, 899)]
    gyro[500:505, 1] += 1e-9 * np.arange(5)  # one axis goes on
    assert found(gyro, accel) == [("zero", "accel", 700, 899)]


def test_a_block_that_is_written_twice_is_no_measurement() -> None:
    gyro, accel = samples()
    gyro[600:640] = gyro[560:600]
    accel[610:614] = accel[600:604]
    assert found(gyro, accel) == [("repeated", "gyro", 600, 639)]
    accel[909:914] = accel[904:909]
    assert found(gyro, accel) == [("repeated", "gyro", 600, 639), ("repeated", "accel", 909, 913)]
    accel[911, 1] += 1e-9
    assert found(gyro, accel) == [("repeated", "gyro", 600, 639)]


def test_coarse_samples_at_rest_repeat_by_chance() -> None:
    """Five rows in a row repeat those of five rows before 4 times in a million by chance."""
    coarse = np.zeros((1_000_000, 3))
    coarse[:, 0] = np.random.default_rng(6).integers(0, 5, len(coarse))
    assert _repeated(coarse) == []
    coarse[:, 1] = np.arange(len(coarse))
    coarse[7000:7020] = coarse[6000:6020]
    assert _repeated(coarse) == [(7000, 7019)]


def test_a_periodic_simulation_without_noise_is_right() -> None:
    t = 5e-3 * np.arange(SIZE)[:, None]
    gyro, accel = (np.round(np.sin(2 * np.pi * t + phase), 6) for phase in ([0, 1, 2], [3, 4, 5]))
    assert found(gyro, accel) == []
    assert _repeated(gyro[:400]) == [(200, 399)]  # as long as its distance: it may be a block


def test_a_frozen_part_of_a_block_that_is_written_twice_is_frozen() -> None:
    gyro, accel = samples()
    gyro[100:110] = gyro[100]
    gyro[300:320] = gyro[95:115]
    parts = [("frozen", 100, 109), ("repeated", 300, 304), ("frozen", 305, 314)]
    assert [(kind, *rows) for kind, _, *rows in found(gyro, accel)] == [
        *parts, ("repeated", 315, 319)
    ]  # fmt: skip


def test_a_sensor_of_half_the_rate_is_not_frozen() -> None:
    gyro, accel = samples()
    gyro = np.repeat(gyro[::6], 6, axis=0)[:SIZE]
    assert found(gyro, accel) == []
    gyro[300:420] = gyro[300]
    assert found(gyro, accel) == [("frozen", "gyro", 300, 419)]


def test_a_clipped_axis_piles_up_at_its_end_and_a_quantised_one_does_not() -> None:
    gyro, accel = samples()
    clipped = np.minimum(accel, [99, 1.5, 99])
    rows = np.flatnonzero(clipped[:, 1] == 1.5)
    assert len(rows) > 100
    stretches = found(gyro, clipped)
    assert {each[:2] for each in stretches} == {("saturated", "accel")}
    covered = np.concatenate([np.arange(a, b + 1) for *_, a, b in stretches])
    assert np.array_equal(covered, rows)
    assert found(np.round(gyro, 2), np.round(accel, 1)) == []
    lower = np.maximum(gyro, [-0.4, -9, -9])
    assert {each[:2] for each in found(lower, accel)} == {("saturated", "gyro")}


@pytest.mark.parametrize(
    ("rows", "before", "is_clipped"),
    [
        ([500, 501, 502, 503], 1, True),
        ([500, 501, 502, 600], 1, False),
        ([500, 501, 502], 1, False),
        ([*range(500, 506), *range(600, 606)], 4, True),
        ([*range(500, 506), *range(600, 606)], 5, False),
    ],
)
def test_four_in_a_row_at_an_end_that_piles_up_threefold_are_clipped(
    rows: list[int], before: int, is_clipped: bool
) -> None:
    for sign in (1, -1):
        gyro, accel = np.random.default_rng(5).normal(0, 0.1, (2, SIZE, 3))
        end = np.abs(gyro[:, 1]).max()
        gyro[100 : 100 + 7 * before : 7, 1] = sign * (end + 1e-3)
        gyro[rows, 1] = sign * (end + 2e-3)
        count = len(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1))
        assert [each[0] for each in found(gyro, accel)] == is_clipped * count * ["saturated"]


def test_a_frozen_sample_far_away_is_one_stretch() -> None:
    gyro, accel = samples()
    gyro[1000:1005] = gyro[1000] + 3
    assert found(gyro, accel) == [("frozen", "gyro", 1000, 1004)]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("sensor", "size"), [(0, 0.06), (1, 0.6)])
def test_a_spike_stands_out_of_its_neighbours_and_of_the_recording(
    sign: int, sensor: int, size: float
) -> None:
    quiet = np.random.default_rng(1).normal(0, 1e-3, (SIZE, 3))
    for factor, count in ((1.2, 1), (0.7, 0)):
        pair = [quiet.copy(), quiet + np.array([0, 0, 9.81])]
        pair[sensor][800, 1] += sign * factor * size
        stretches = bad_stretches(*pair)
        assert [(each.kind, each.first, each.last) for each in stretches] == [
            ("spike", 800, 800)
        ] * count
        if count:
            assert stretches[0].size == pytest.approx(factor * size, abs=5e-3)


def test_spikes_in_a_row_are_one_stretch() -> None:
    gyro, accel = samples()
    gyro[1000:1005] += [3.0, 0, 0]
    assert found(gyro, accel) == [("spike", "gyro", 1000, 1004)]


def test_vibration_is_no_spike() -> None:
    gyro, accel = samples()
    accel += np.random.default_rng(2).normal(0, 5.0, (SIZE, 3))
    accel[700:1300] += np.random.default_rng(3).normal(0, 30.0, (600, 3))
    assert found(gyro, accel) == []


def test_a_short_impact_that_its_neighbours_share_is_no_spike() -> None:
    gyro, accel = samples()
    accel[900:915] += np.random.default_rng(4).normal(0, 30.0, (15, 3))
    assert found(gyro, accel) == []
