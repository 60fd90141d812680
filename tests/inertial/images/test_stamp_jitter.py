"""Stamps of images that jitter: the tracks tell the right ones from those that are wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bundle.inertial.tracking import stamp_jitter
from bundle.inertial.tracking.sequence_axes import axes_findings
from bundle.inertial.tracking.stamp_jitter import jitter_findings, regular_stamps
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import SyntheticFlight, synthesize_flight

Array = np.ndarray[Any, Any]


@pytest.fixture(scope="module")
def flight() -> SyntheticFlight:
    return synthesize_flight(motion="loop", duration=10.0, num_tracks=50, seed=4)


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
    assert found.evidence["ratio"] > 40
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
    monkeypatch.setattr(stamp_jitter, "regular_stamps", lambda _: stamps)
    monkeypatch.setattr(stamp_jitter, "turns_of_tracks", lambda *_: [])
    # regular stamps: errors of 1 a coordinate, so that |e|^2 = 3 / 1.48^2
    size = math.sqrt(((1.48**2 + 3) * math.exp(ratio / pairs) - 1.48**2) / 3)

    class Pairs:
        camera, spans = np.zeros((pairs, 3)), np.zeros((pairs, 2), int)

        def __init__(self, *_: Any, **__: Any) -> None:
            self.size = size

        def at(self, _: Array) -> Any:
            return SimpleNamespace(imu=lambda _: 0, errors=lambda *_: np.ones((pairs, 3)))

        def imu(self, _: float) -> int:
            return 0

        def errors(self, *_: Any) -> Array:
            return np.full((pairs, 3), self.size)

    monkeypatch.setattr(stamp_jitter, "RotationPairs", Pairs)
    images: Any = SimpleNamespace(stamps=stamps + np.round(1e9 * jitter * sign).astype(np.int64))
    calibration = SimpleNamespace(camera_from_imu=(0, 0, 0, 1, 0, 0, 0))
    recording: Any = SimpleNamespace(calibration=calibration, name="S")
    assert len(jitter_findings(images, recording)) == count
