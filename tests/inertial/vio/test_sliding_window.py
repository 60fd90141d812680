"""The sliding window over synthetic flights: accuracy, counts, what leaves and how."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import SlidingWindow, _core
from bundle.errors import InputError
from bundle.inertial.vio.landmark_table import FrameTracks
from tests.inertial.vio.window_scenes import CAMERA, FOCAL, GRAVITY, NOISE, Flight

SIGMA = 1.0 / FOCAL


def run(flight: Flight, tracks: Any, start: int = 4, **options: Any) -> SlidingWindow:
    """Begin with the true states of the first keyframes and follow the others."""
    settings = {"imu_noise_scale": 1.0, "min_parallax": 0.0, "min_translation": 0.0, **options}
    window = SlidingWindow(CAMERA, NOISE, FOCAL, gravity=GRAVITY, **settings)
    window.start(
        flight.stamps[:start], flight.states[:start], tracks[:start], flight.intervals[: start - 1]
    )
    for k in range(start, len(flight.stamps)):
        window.add_frame(int(flight.stamps[k]), flight.intervals[k - 1], tracks[k])
    return window


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight(24, 11, landmarks=80)


@pytest.mark.parametrize("form", ["information", "square_root"])
def test_an_exact_flight_is_followed_exactly(flight: Flight, form: str) -> None:
    window = run(flight, flight.tracks(), prior_form=form, window=6)
    assert len(window.frames) == 7  # beside the newest
    np.testing.assert_allclose(window.states, flight.states[-7:], rtol=0, atol=1e-4)
    assert [r.nullity for r in window.records] == [None] * len(window.records)


def test_marginalising_agrees_with_keeping_everything(flight: Flight) -> None:
    """And dropping does not."""
    tracks = flight.tracks(SIGMA)
    options: dict[str, Any] = {"loss": "trivial", "max_num_iterations": 30, "time_budget": 100.0}
    options |= {"function_tolerance": 1e-12, "marginal_parallax": 0.0, "window": 8}
    speeds = {
        how: np.linalg.norm(run(flight, tracks, marginalize=how, **options).states[-1, 7:10])
        for how in ("keep", "marginalize", "drop")
    }
    bias = {
        how: run(flight, tracks, marginalize=how, **options).states[-1, 13:16]
        for how in ("keep", "marginalize", "drop")
    }
    near = np.linalg.norm(bias["marginalize"] - bias["keep"])
    far = np.linalg.norm(bias["drop"] - bias["keep"])
    assert near < 0.5 * far
    assert abs(speeds["marginalize"] - speeds["keep"]) < 0.02


@pytest.mark.parametrize(
    ("jacobians", "expected"), [("first_estimate", 4), ("current", 3), ("relinearize_prior", 3)]
)
def test_nullity_tells_which_jacobians_were_taken(
    flight: Flight, jacobians: str, expected: int
) -> None:
    window = run(flight, flight.tracks(SIGMA), jacobians=jacobians, nullity=True, window=6)
    settled = [r for r in window.records if r.marginalized][3:]
    assert {record.nullity for record in settled} == {expected}
    assert all(bool(r.alarms) == (expected == 3) for r in settled)


def test_a_prior_on_the_start_leaves_nothing_free(flight: Flight) -> None:
    options = {"start_position_sigma": 0.01, "start_yaw_sigma": 0.1}
    window = run(flight, flight.tracks(SIGMA), nullity=True, covariance=True, window=6, **options)
    last = window.records[-1]
    assert (last.nullity, last.expected_nullity) == (0, 0)
    assert last.yaw_sigma is not None
    assert 0.1 < np.degrees(last.yaw_sigma) < 5


def test_single_precision_raises_the_alarm_and_its_square_root_does_not(flight: Flight) -> None:
    tracks = flight.tracks(SIGMA)
    settings: dict[str, Any] = {"window": 6, "precision": "single"}
    plain = run(flight, tracks, prior_form="information", **settings).records[-1]
    root = run(flight, tracks, prior_form="square_root", **settings).records[-1]
    double = run(flight, tracks, window=6).records[-1]
    assert plain.prior_asymmetry is not None
    assert plain.prior_asymmetry > 1e-9
    assert plain.alarms
    assert double.prior_ratio is not None
    assert double.prior_ratio > 1e-7
    assert root.prior_min_eigenvalue is not None
    assert root.prior_max_eigenvalue is not None
    assert root.prior_min_eigenvalue > -1e-12 * root.prior_max_eigenvalue
    assert not double.alarms


def test_records_account_for_each_keyframe(flight: Flight) -> None:
    window = run(flight, flight.tracks(SIGMA), window=6)
    records = window.records
    assert [r.timestamp_ns for r in records] == [int(s) for s in flight.stamps[3:]]
    gone = [r.marginalized["timestamp_ns"] for r in records if r.marginalized]
    assert gone == [int(s) for s in flight.stamps[: len(gone)]]
    for record in records:
        assert record.num_rows > record.num_columns
        assert set(record.costs) == {"visual", "imu", "bias_walk", "prior"}
        assert record.excitation_verdict in ("healthy", "marginal")
    late = [r.mean_visual_chi2 for r in records[-8:]]
    assert 0.15 < np.mean([x for x in late if x is not None]) < 0.6


def test_images_that_are_no_keyframes_lose_nothing_of_the_inertia(flight: Flight) -> None:
    """Without new parallax the newest image is replaced, its samples go on."""
    window = run(
        flight, flight.tracks(), min_parallax=1e9, min_tracks=0, max_interval=0.6, window=6
    )
    assert {r.reason for r in window.records} == {"start", "time"}
    gaps = np.diff([f.stamp for f in window.frames if f.is_keyframe]) * 1e-9
    np.testing.assert_allclose(gaps[1:], 0.75, atol=1e-6)
    for before, frame in zip(window.frames, window.frames[1:], strict=False):
        assert frame.interval is not None
        seconds = 1e-9 * (frame.stamp - before.stamp)
        assert frame.interval.dt.sum() == pytest.approx(seconds)
    np.testing.assert_allclose(window.states[-1], flight.states[-1], rtol=0, atol=1e-3)


def test_wrong_tracks_are_left_out(flight: Flight) -> None:
    tracks = flight.tracks(SIGMA)
    rng = np.random.default_rng(0)
    wrong = rng.choice(80, 8, replace=False)
    bad = []
    for seen in tracks:
        xy = seen.xy.copy()
        lies = np.isin(seen.ids, wrong)
        xy[lies] += rng.normal(0, 60 / FOCAL, (int(lies.sum()), 2))
        bad.append(seen._replace(xy=xy))
    window = run(flight, bad, window=8)
    assert sum(r.num_rejected_tracks for r in window.records) > 8
    good = run(flight, tracks, window=8)
    errors = [np.linalg.norm(w.states[-1, 4:7] - flight.states[-1, 4:7]) for w in (window, good)]
    assert errors[0] < 3 * errors[1] + 0.05


def test_biases_far_from_those_of_the_integration_are_integrated_anew() -> None:
    bias = np.array([0.3, -0.2, 0.25])
    flight = Flight(10, 3, landmarks=60, gyro_bias=bias, period=1.0, samples=100)
    states = flight.states.copy()
    states[:, 10:13] = 0
    flight.states = states
    window = SlidingWindow(
        CAMERA, NOISE, FOCAL, gravity=GRAVITY, start_gyro_bias_sigma=1.0, min_translation=0.0,
        min_parallax=0.0, window=8, imu_noise_scale=1.0,
    )  # fmt: skip
    tracks = flight.tracks()
    window.start(flight.stamps[:4], states[:4], tracks[:4], flight.intervals[:3])
    for k in range(4, 10):
        window.add_frame(int(flight.stamps[k]), flight.intervals[k - 1], tracks[k])
    assert sum(r.num_repropagated for r in window.records) > 0
    np.testing.assert_allclose(window.states[-1, 10:13], flight.gyro_bias, atol=2e-3)


def test_bad_calls_are_refused(flight: Flight) -> None:
    tracks = flight.tracks()
    window = SlidingWindow(CAMERA, NOISE, FOCAL)
    with pytest.raises(InputError, match="start"):
        window.add_frame(1, flight.intervals[0], tracks[0])
    with pytest.raises(InputError, match="two rows"):
        window.start(flight.stamps[:1], flight.states[:1], tracks[:1], [])
    with pytest.raises(InputError, match="per image"):
        window.start(flight.stamps[:3], flight.states[:3], tracks[:2], flight.intervals[:2])
    with pytest.raises(InputError, match="camera_from_imu"):
        SlidingWindow([1.0, 2.0], NOISE, FOCAL)
    with pytest.raises(InputError, match="focal"):
        SlidingWindow(CAMERA, NOISE, 0.0)
    window.start(flight.stamps[:4], flight.states[:4], tracks[:4], flight.intervals[:3])
    with pytest.raises(InputError, match="stamp"):
        window.add_frame(int(flight.stamps[2]), flight.intervals[0], tracks[2])


def test_tracks_that_would_be_misread_are_refused(flight: Flight) -> None:
    tracks = flight.tracks()
    window = SlidingWindow(CAMERA, NOISE, FOCAL)
    begin = (flight.stamps[:4], flight.states[:4])
    swapped = tracks[1]._replace(ids=tracks[1].ids[::-1])
    with pytest.raises(InputError, match=r"tracks\[1\].*ascend"):
        window.start(*begin, [tracks[0], swapped, *tracks[2:4]], flight.intervals[:3])
    short = tracks[2]._replace(xy=tracks[2].xy[1:])
    with pytest.raises(InputError, match=r"tracks\[2\]"):
        window.start(*begin, [*tracks[:2], short, tracks[3]], flight.intervals[:3])
    with pytest.raises(InputError, match="stamps"):
        window.start(flight.stamps[[0, 2, 1, 3]], *begin[1:], tracks[:4], flight.intervals[:3])
    with pytest.raises(InputError, match="quaternion"):
        SlidingWindow([0.0] * 7, NOISE, FOCAL)
    window.start(*begin, tracks[:4], flight.intervals[:3])
    blind = tracks[4]._replace(xy=np.full_like(tracks[4].xy, np.nan))
    with pytest.raises(InputError, match="finite"):
        window.add_frame(int(flight.stamps[4]), flight.intervals[3], blind)


@pytest.mark.parametrize("marginalize", ["marginalize", "drop"])
@pytest.mark.parametrize("count", [0, 1])
def test_a_window_without_tracks_goes_on_by_the_imu(
    flight: Flight, marginalize: str, count: int
) -> None:
    """No track at all, or one: what is left is inertia, which here is exact."""
    tracks = [FrameTracks(*(part[:count] for part in seen)) for seen in flight.tracks()]
    window = run(flight, tracks, window=3, marginalize=marginalize)
    assert len(window.records) == len(flight.stamps) - 3
    np.testing.assert_allclose(window.states[-1], flight.states[-1], rtol=0, atol=1e-6)


def test_states_without_a_rotation_are_refused(flight: Flight) -> None:
    states = flight.states[:4].copy()
    states[2, :4] = 0
    window = SlidingWindow(CAMERA, NOISE, FOCAL)
    with pytest.raises(InputError, match=r"states\[2\].*quaternion"):
        window.start(flight.stamps[:4], states, flight.tracks()[:4], flight.intervals[:3])


def test_landmarks_without_parallax_are_carried_and_stay(flight: Flight) -> None:
    """No landmark goes into the prior; all go on, so that the window keeps seeing."""
    window = run(flight, flight.tracks(SIGMA), window=4, marginal_parallax=1e4)
    left = [record for record in window.records if record.marginalized]
    assert len(left) > 10
    assert all(record.num_absorbed == 0 and record.num_carried > 5 for record in left)
    assert left[-1].num_landmarks > 20
    assert np.linalg.norm(window.states[-1, 4:7] - flight.states[-1, 4:7]) < 0.3


def test_yaw_is_about_the_vertical(flight: Flight) -> None:
    options = {"start_position_sigma": 0.01, "start_yaw_sigma": 0.1}
    window = run(flight, flight.tracks(SIGMA), covariance=True, window=6, **options)
    assert window.covariance is not None
    up = Rotation.from_quat(window.states[-1, :4]).as_matrix().T @ [0.0, 0.0, 1.0]
    expected = np.sqrt(up @ window.covariance[:3, :3] @ up)
    assert window.records[-1].yaw_sigma == pytest.approx(expected, rel=1e-9)
    assert np.abs(up[:2]).max() > 0.05  # it is tilted


def test_a_track_that_is_behind_one_camera_is_left_out(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if it fits all others: no later solve could begin with it."""
    solve = _core.solve_window
    asked: list[dict[str, Any]] = []

    def with_one_behind(window: dict[str, Any], *others: Any) -> dict[str, Any]:
        asked.append(window)
        solved = solve(window, *others)
        if len(asked) > 1:
            return solved
        norms = np.array(solved["residual_norms"])
        norms[0] = np.inf
        return {**solved, "residual_norms": norms}

    monkeypatch.setattr(_core, "solve_window", with_one_behind)
    window = run(flight, flight.tracks(), 6)
    first = asked[0]
    assert np.sum(first["landmarks"] == first["landmarks"][0]) > 2
    assert sum(record.num_rejected_tracks for record in window.records) == 1
