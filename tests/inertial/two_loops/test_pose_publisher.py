"""Poses per sample: propagation, rewind and replay, corrections in shares."""

import math

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.inertial.two_loops.pose_publisher import Correction, Solution, YawMotion
from tests.inertial.two_loops.motion import PERIOD_NS, Flight


@pytest.fixture(scope="module")
def flight():
    return Flight(400)


def test_without_solutions_it_is_propagation(flight):
    publisher = flight.publisher()
    for k in range(400):
        pose = flight.publish(publisher, k)
        assert pose.state == pytest.approx(flight.states[k], abs=1e-12)
        assert pose.timestamp_ns == flight.stamps[k]
        assert (pose.shift, pose.turn, pose.replayed) == (0, 0, 0)


@pytest.mark.parametrize("between", [0, 2_000_000])  # at a sample, and 2 ms after one
def test_a_solution_of_the_past_is_rewound_to_and_replayed(flight, between):
    publisher = flight.publisher()
    for k in range(201):
        flight.publish(publisher, k)
    rng = np.random.default_rng(1)
    state = flight.states[150].copy()
    state[4:] += 0.01 * rng.standard_normal(12)
    publisher.solutions.put(Solution(flight.stamps[150] + between, state))
    pose = flight.publish(publisher, 201)
    rows = slice(150, 201)
    dt = np.full(51, 0.005)
    dt[0] -= 1e-9 * between
    expected = bundle.propagate(state, flight.gyro[rows], flight.accel[rows], dt)[-1]
    assert pose.state == pytest.approx(expected, abs=1e-12)
    assert pose.replayed == 51
    assert pose.solution_timestamp_ns == flight.stamps[150] + between
    follow = flight.publish(publisher, 202)
    assert follow.replayed == 0
    assert follow.solution_timestamp_ns == pose.solution_timestamp_ns
    # The same frame solved once more: what held there is still known.
    publisher.solutions.put(Solution(flight.stamps[150] + between, state))
    again = flight.publish(publisher, 203)
    assert again.replayed == 53
    rows, dt = slice(150, 203), np.r_[dt, 0.005, 0.005]
    expected = bundle.propagate(state, flight.gyro[rows], flight.accel[rows], dt)[-1]
    assert again.state == pytest.approx(expected, abs=1e-12)
    assert publisher.num_refused == 0


def test_the_newest_solution_counts_and_an_early_one_waits(flight):
    publisher = flight.publisher()
    for k in range(11):
        flight.publish(publisher, k)
    wrong = flight.states[3] + 1
    publisher.solutions.put(Solution(flight.stamps[3], wrong))
    publisher.solutions.put(Solution(flight.stamps[12] + 1, flight.states[12]))
    before = flight.publish(publisher, 11)
    assert before.solution_timestamp_ns == flight.stamps[0]
    assert flight.publish(publisher, 12).solution_timestamp_ns == flight.stamps[0]
    assert flight.publish(publisher, 13).solution_timestamp_ns == flight.stamps[12] + 1


def test_solutions_that_no_sample_reaches_are_refused_and_memory_is_bounded(flight):
    publisher = flight.publisher(memory=0.1)
    for k in range(200):
        flight.publish(publisher, k)
    assert len(publisher._samples) <= 22
    publisher.solutions.put(Solution(flight.stamps[100], flight.states[100]))
    pose = flight.publish(publisher, 200)
    assert publisher.num_refused == 1
    assert pose.solution_timestamp_ns == flight.stamps[0]
    publisher.solutions.put(Solution(flight.stamps[195], flight.states[195]))
    flight.publish(publisher, 201)
    publisher.solutions.put(Solution(flight.stamps[190], flight.states[190]))
    pose = flight.publish(publisher, 202)
    assert pose.solution_timestamp_ns == flight.stamps[195]
    assert publisher.num_refused == 2
    assert len(publisher._samples) < 12


@pytest.mark.parametrize("num_shares", [1, 40])
def test_a_correction_moves_no_pose_by_more_than_its_share(flight, num_shares):
    publisher = flight.publisher(num_shares=num_shares)
    for k in range(100):
        flight.publish(publisher, k)
    motion = YawMotion(0.2, [3.0, -2.0, 0.5])
    publisher.corrections.put(Correction(flight.stamps[90], motion))
    total = np.linalg.norm(motion.moved(flight.states[100])[4:7] - flight.states[100, 4:7])
    # The platform goes on while the turn is under way: what is left changes with its place.
    drift = 0.2 * 5.0 * num_shares * 0.005
    last = flight.states[99]
    for k in range(100, 100 + num_shares):
        pose = flight.publish(publisher, k)
        assert pose.shift <= (total + drift) / num_shares * (1 + 1e-9)
        assert pose.turn == pytest.approx(0.2 / num_shares)
        # The whole change is the way since the pose before, and the share.
        way = np.linalg.norm(flight.states[k, 4:7] - flight.states[k - 1, 4:7])
        assert np.linalg.norm(pose.state[4:7] - last[4:7]) <= way + pose.shift + 1e-9
        last = pose.state
    assert last == pytest.approx(motion.moved(flight.states[k]), abs=1e-12)
    assert publisher.anchor is publisher.target
    pose = flight.publish(publisher, k + 1)
    assert (pose.shift, pose.turn) == (0, 0)


def test_far_from_the_origin_a_turn_does_not_swing():
    flight = Flight(120)
    far = np.array([1e5, 0, 0])
    start = flight.states[0].copy()
    start[4:7] += far
    publisher = bundle.PosePublisher(flight.stamps[0], start, num_shares=50)
    flight.publish(publisher, 0)
    # About the platform: it stays where it is, and turns.
    motion = YawMotion(0, far) @ YawMotion(0.5) @ YawMotion(0, -far)
    publisher.corrections.put(Correction(flight.stamps[0], motion))
    shifts = [flight.publish(publisher, k).shift for k in range(1, 51)]
    assert max(shifts) < 0.5 * 10 / 50 * 1.1


def test_corrections_are_composed_and_never_assigned(flight):
    publisher = flight.publisher(num_shares=1)
    first, second = YawMotion(0.1, [1, 0, 0]), YawMotion(0.15, [1.5, 0.2, 0])
    elsewhere = YawMotion(-0.4, [0, 7, 0])
    publisher.corrections.put(Correction(flight.stamps[0], first))
    flight.publish(publisher, 0)
    publisher.move(elsewhere)
    flight.publish(publisher, 1)
    assert publisher.target.yaw == pytest.approx(-0.3)
    publisher.corrections.put(Correction(flight.stamps[1], second))
    pose = flight.publish(publisher, 2)
    expected = second @ first.inverse() @ elsewhere @ first
    assert pose.state == pytest.approx(expected.moved(flight.states[2]), abs=1e-12)
    # Of several the newest counts: each says all that the graph knows.
    for motion in (first, elsewhere, second):
        publisher.corrections.put(Correction(flight.stamps[2], motion))
    pose = flight.publish(publisher, 3)
    assert pose.state == pytest.approx(expected.moved(flight.states[3]), abs=1e-12)
    assert pose.shift == pytest.approx(0, abs=1e-12)


def test_a_correction_commutes_with_the_replay(flight):
    """Corrected at its date and replayed from there, or replayed and corrected: one pose."""
    publisher = flight.publisher(num_shares=1)
    for k in range(100):
        flight.publish(publisher, k)
    motion = YawMotion(0.3, [4, 5, -1])
    publisher.corrections.put(Correction(flight.stamps[40], motion))
    publisher.solutions.put(Solution(flight.stamps[60], flight.states[60]))
    pose = flight.publish(publisher, 100)
    rows, dt = slice(40, 100), np.full(60, 0.005)
    dated = motion.moved(flight.states[40])
    replayed = bundle.propagate(dated, flight.gyro[rows], flight.accel[rows], dt)[-1]
    assert pose.state == pytest.approx(replayed, abs=1e-11)


def test_a_start_before_the_first_sample_is_bridged_by_it(flight):
    publisher = bundle.PosePublisher(flight.stamps[0] - PERIOD_NS, flight.states[0])
    pose = flight.publish(publisher, 0)
    expected = bundle.propagate(flight.states[0], flight.gyro[:1], flight.accel[:1], [0.005])[0]
    assert pose.state == pytest.approx(expected, abs=1e-14)


def test_misuse(flight):
    publisher = flight.publisher()
    flight.publish(publisher, 1)
    state = flight.states[0]
    for call, word in (
        (lambda: flight.publish(publisher, 1), "after"),
        (lambda: flight.publish(publisher, 0), "after"),
        (lambda: publisher.publish(flight.stamps[2], [1, 2], [0, 0, 9.81]), "gyro"),
        (lambda: publisher.publish(flight.stamps[2], [1, 2, 3], [0, 0, math.nan]), "accel"),
        (lambda: flight.publisher().publish(0, [0] * 3, [0] * 3), "start"),
        (lambda: publisher.move(1), "YawMotion"),
        (lambda: Solution(0, state[:7]), "state"),
        (lambda: Solution(0, state + math.inf), "finite"),
        (lambda: bundle.PosePublisher(0, state, num_shares=0), "num_shares"),
        (lambda: bundle.PosePublisher(0, state, memory=0), "memory"),
        (lambda: bundle.PosePublisher(0, state, gravity=9.81), "gravity"),
        (lambda: bundle.PosePublisher(0, state[:7]), "state"),
    ):
        with pytest.raises(InputError, match=word):
            call()
    pose = flight.publish(publisher, 2)
    assert pose.state == pytest.approx(
        bundle.propagate(state, flight.gyro[[1, 1]], flight.accel[[1, 1]], [0.005] * 2)[-1]
    )
    assert "PosePublisher: 2 poses" in repr(publisher)
    assert "position" in repr(pose)
