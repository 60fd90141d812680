"""Rates of a wrong scale, and stamps that jitter, against the tracks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bundle.inertial.tracking import sequence_axes
from bundle.inertial.tracking.sequence_axes import (
    _recording,
    axes_findings,
    explanations,
    jitter_findings,
    regular_stamps,
    scale_findings,
    scale_of_rates,
)
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import SyntheticFlight, synthesize_flight

Array = np.ndarray[Any, Any]

pytestmark = pytest.mark.usefixtures("few")


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return synthesize_flight(motion="loop", duration=10.0, num_tracks=50, seed=4)


def rates_of(given: Sequence, scale: float, bias: float = 0.0, milliseconds: int = 0) -> Sequence:
    stamps = given.track_timestamps_ns + 1_000_000 * milliseconds
    return replace(given, gyro=scale * given.gyro + bias, track_timestamps_ns=stamps)


@pytest.mark.parametrize(
    ("scale", "bias", "milliseconds", "words"),
    [
        (1.0, 0.0, 0, ""),
        (1.005, 0.05, 0, ""),
        (1.03, 0.0, 0, "gyro: expected rates that agree with the tracks, found 1.0"),
        (1.03, 0.05, 10, "the scale of the gyroscope or the focal length is wrong"),
        (0.97, -0.05, 0, "found 0.9"),
        (1.03, 0.0, 100, ""),  # the offset is the error to name
    ],
)
def test_a_wrong_scale_of_rates_is_named(
    flight: SyntheticFlight, scale: float, bias: float, milliseconds: int, words: str
) -> None:
    found = axes_findings(rates_of(flight.sequence, scale, bias, milliseconds), "S")
    found = tuple(each for each in found if each.kind == "gyro scale")
    assert [each.is_problem for each in found] == ([True] if words else [])
    for each in found:
        assert words in each.sentence
        error, sigma = each.evidence["ratio"] - scale, each.evidence["sigma"]
        assert abs(error) < 3 * sigma < 0.012


@pytest.mark.parametrize(("change", "count"), [(0.0, 0), (0.01, 0), (0.05, 1), (-0.2, 1)])
def test_a_jump_of_the_bias_is_named_with_its_size_and_time(
    flight: SyntheticFlight, change: float, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequence_axes, "right_signs", lambda _: None)  # asked where no bias jumps
    gyro = flight.sequence.gyro.copy()
    gyro[1000:, 1] += change
    found = explanations(replace(flight.sequence, gyro=gyro), "S")
    assert [each.kind for each in found] == ["gyro bias"] * count
    for each in found:
        assert each.evidence["change"] == pytest.approx(abs(change), rel=0.15)
        assert abs(each.evidence["row"] - 1000) < 200  # a second
        assert not each.is_problem


def test_a_clipped_gyroscope_has_no_scale(flight: SyntheticFlight) -> None:
    wrong = rates_of(flight.sequence, 1.1)
    clipped = replace(wrong, gyro=wrong.gyro.clip(-0.3, 0.3))
    counts = [
        len(scale_findings(SequenceImages(each), _recording(each, "S")))
        for each in (wrong, clipped)
    ]
    assert counts == [1, 0]


class Turned:
    """Rotations by exact tracks, of a random walk of rates or of a turntable, and of samples."""

    def __init__(self, scale: float, errors: float, turntable: bool = False, late: float = 0.0):
        rng = np.random.default_rng(2)
        count = 60
        self._rates = np.full((count, 3), 0.5) if turntable else rng.normal(size=(count, 3))
        self._change = 0 * self._rates if turntable else rng.normal(size=(count, 3))
        self._scale = scale
        self.spans = np.tile([0, 500_000_000], (count, 1))
        sigma = 2e-3
        noise = sigma * rng.normal(size=(count, 3)) * errors
        self.camera = 0.5 * self._rates + late * self._change + noise + 0.01
        self.information = np.tile(np.eye(3) / sigma**2, (count, 1, 1))

    def imu(self, shift: float) -> Array:
        found: Array = self._scale * (0.5 * self._rates + shift * self._change)
        return found


def scale_of(pairs: Any) -> tuple[float, float]:
    return scale_of_rates(pairs, np.eye(3))[:2]


def test_the_scale_has_the_sigma_of_its_tracks() -> None:
    """2e-3 / (0.5 sqrt(180)) without robust weights, which cost a third."""
    for scale in (0.97, 1.0, 1.03):
        found, sigma = scale_of(Turned(scale, errors=1.0))
        assert abs(found - scale) < 3 * sigma
        assert 1.0 < sigma / (2e-3 / (0.5 * math.sqrt(180))) < 1.5


def test_the_scale_counts_only_if_nothing_else_is_wrong() -> None:
    """Errors of 1.6 and 2.6 deviations are on both sides of a variance of 4; 30 ms of an offset."""
    assert math.isfinite(scale_of(Turned(1.0, errors=1.6))[0])
    assert math.isnan(scale_of(Turned(1.0, errors=2.6))[0])
    assert scale_of(Turned(1.03, errors=1.0, late=0.02))[0] == pytest.approx(1.03, abs=1.5e-3)
    assert math.isnan(scale_of(Turned(1.03, errors=1.0, late=0.04))[0])
    assert math.isnan(scale_of(Turned(-1.0, errors=1.0))[0])


def test_a_turntable_does_not_tell_the_scale_from_the_bias() -> None:
    """A bias of 0.1 rad/s in each axis is 0.2 of a rate of 0.5."""
    found, sigma = scale_of(Turned(1.0, errors=1.0, turntable=True))
    assert abs(found - 1) < sigma
    assert sigma > 0.1


def test_regular_stamps_number_images_through_gaps_and_drifts() -> None:
    number = np.array([0, 1, 2, 6, 7, 8])
    true = 1000 + 50_500_000 * number
    np.testing.assert_array_equal(regular_stamps(true), true)
    late = true + 7_000_000 * np.array([1, -1, 0, 0, -1, 1])
    np.testing.assert_array_equal(regular_stamps(late), true)


def restamped(sequence: Sequence, change: Callable[[Array], Array]) -> Sequence:
    stamps, image = np.unique(sequence.track_timestamps_ns, return_inverse=True)
    return replace(sequence, track_timestamps_ns=change(stamps)[image])


def jittered(stamps: Array) -> Array:
    noise = np.random.default_rng(3).normal(0, 4e6, len(stamps))
    moved: Array = stamps + noise.astype(np.int64)
    return moved


def test_wrong_stamps_are_named_and_right_ones_are_not(flight: SyntheticFlight) -> None:
    given = flight.sequence
    (found,) = axes_findings(restamped(given, jittered), "S")
    assert (found.kind, found.is_problem) == ("stamps", False)
    assert "constant rate of 20 Hz" in found.sentence
    assert found.evidence["jitter"] == pytest.approx(4e-3, rel=0.1)
    assert found.evidence["ratio"] > 30
    assert axes_findings(given, "S") == ()
    # right stamps of a camera without a constant rate: steps of 2, 2 and 3 periods
    image = np.unique(given.track_timestamps_ns, return_inverse=True)[1]
    kept = np.isin(image % 7, (0, 2, 4))
    irregular = replace(
        given, track_timestamps_ns=given.track_timestamps_ns[kept],
        track_ids=given.track_ids[kept], xy=given.xy[kept],
    )  # fmt: skip
    assert axes_findings(irregular, "S") == ()


@pytest.mark.parametrize(
    ("jitter", "pairs", "ratio", "count"),
    [
        (1.01e-3, 30, 2 * math.log(1e4) + 0.01, 1),
        (0.99e-3, 30, 2 * math.log(1e4) + 0.01, 0),
        (1.01e-3, 29, 2 * math.log(1e4) + 0.01, 0),
        (1.01e-3, 30, 2 * math.log(1e4) - 0.01, 0),
    ],
)
def test_thresholds(
    monkeypatch: pytest.MonkeyPatch, jitter: float, pairs: int, ratio: float, count: int
) -> None:
    stamps = 50_000_000 * np.arange(pairs + 1)
    sign = np.where(np.arange(pairs + 1) % 2, 1, -1)
    monkeypatch.setattr(sequence_axes, "regular_stamps", lambda _: stamps)
    monkeypatch.setattr(sequence_axes, "turns_of_tracks", lambda *_: [])
    # regular stamps: errors of 1 a coordinate, so that |e|^2 = 3 / 1.48^2
    size = math.sqrt(((1.48**2 + 3) * math.exp(ratio / pairs) - 1.48**2) / 3)

    class Pairs:
        camera, spans, lens = np.zeros((pairs, 3)), np.zeros((pairs, 2), int), np.eye(3)

        def __init__(self, *_: Any, **__: Any) -> None:
            self.size = size

        def at(self, _: Array) -> Any:
            return SimpleNamespace(imu=lambda _: 0, errors=lambda *_: np.ones((pairs, 3)))

        def imu(self, _: float) -> int:
            return 0

        def errors(self, *_: Any) -> Array:
            return np.full((pairs, 3), self.size)

    monkeypatch.setattr(sequence_axes, "RotationPairs", Pairs)
    images: Any = SimpleNamespace(stamps=stamps + np.round(1e9 * jitter * sign).astype(np.int64))
    recording: Any = SimpleNamespace(name="S")
    assert len(jitter_findings(images, recording)) == count
