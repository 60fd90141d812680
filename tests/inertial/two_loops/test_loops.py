"""The two loops beside a publisher: closures, stalls, deadlines, what goes wrong in a thread."""

import threading
import time

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.inertial.two_loops.closure_loop import Closure, Keyframe
from bundle.inertial.two_loops.loop_thread import Ring
from bundle.inertial.two_loops.pose_publisher import Solution, YawMotion
from tests.inertial.two_loops.motion import KEYFRAME_EVERY, PERIOD_NS, Flight, drifted

PATIENCE = 60  # seconds until a thread counts as hung
YAW, SHIFT = 0.05, np.array([0.4, -0.3, 0.1])


def poses_between(a, b):
    from bundle.model.rigid_motions import inverse_poses, multiply_poses

    return multiply_poses(inverse_poses(a[None, :7]), b[None, :7])[0]


def keyframes_of(flight, window):
    for k in range(0, len(window), KEYFRAME_EVERY):
        yield Keyframe(flight.stamps[k], window[k, :7], 1e4)


def closure_of(flight, first, second):
    """Exact, as the true states say."""
    measurement = poses_between(flight.states[first], flight.states[second])
    return Closure(flight.stamps[first], flight.stamps[second], measurement, 1e6)


def test_a_closure_corrects_by_what_the_whole_graph_says():
    flight = Flight(400)
    window = drifted(flight.states, YAW, SHIFT)
    corrections = Ring()
    loop = bundle.ClosureLoop(corrections)
    given = list(keyframes_of(flight, window))
    for keyframe in given:
        loop.put_keyframe(keyframe)
    loop.put_closure(closure_of(flight, 0, 400))
    assert loop.close(PATIENCE)
    correction = corrections.take_newest()
    assert correction.timestamp_ns == flight.stamps[400]
    assert (correction.num_keyframes, correction.num_closures) == (21, 1)
    poses = np.array([keyframe.pose for keyframe in given])
    chain = [(k, k + 1) for k in range(20)]
    graph = bundle.PoseGraph(
        poses=poses,
        edges=np.array([*chain, (0, 20)]),
        measurements=np.array(
            [poses_between(poses[a], poses[b]) for a, b in chain]
            + [closure_of(flight, 0, 400).measurement]
        ),
        information=np.array([1e4 * np.eye(6)] * 20 + [1e6 * np.eye(6)]),
        fixed=np.arange(21) == 0,
    )
    expected = bundle.solve(graph).problem.poses[-1]
    moved = correction.world_from_window.moved(window[400, :7])
    assert moved[4:] == pytest.approx(expected[4:], abs=1e-6)
    assert np.linalg.norm(moved[4:] - flight.states[400, 4:7]) < 0.01
    assert np.linalg.norm(window[400, 4:7] - flight.states[400, 4:7]) > 0.3
    assert loop.num_solves == 1
    assert "21 keyframes" in repr(loop)
    assert "1 closures" in repr(correction)


def test_lost_keyframes_are_bridged_and_their_closures_counted():
    flight = Flight(400)
    window = drifted(flight.states, YAW, SHIFT)
    solving, go_on, graphs = threading.Event(), threading.Event(), []

    def solver(graph):
        graphs.append(graph)
        solving.set()
        assert go_on.wait(PATIENCE)
        return graph.poses

    loop = bundle.ClosureLoop(Ring(), solver=solver, capacity=4)
    keyframes = list(keyframes_of(flight, window))
    for keyframe in keyframes[:3]:
        loop.put_keyframe(keyframe)
    loop.put_closure(closure_of(flight, 0, 40))
    assert solving.wait(PATIENCE)
    for keyframe in keyframes[3:]:  # 18, of which the ring keeps 4
        loop.put_keyframe(keyframe)
    loop.put_closure(closure_of(flight, 0, 100))  # lost
    loop.put_closure(closure_of(flight, 0, 400))
    go_on.set()
    assert loop.close(PATIENCE)
    assert loop.num_lost == 14
    assert loop.num_unknown == 1
    graph = graphs[-1]
    assert graph.num_poses == 7
    assert graph.edges.tolist()[-2:] == [[5, 6], [0, 6]]
    (bridge,) = (k for k, edge in enumerate(graph.edges.tolist()) if edge == [2, 3])
    expected = poses_between(window[40], window[340])
    assert graph.measurements[bridge] == pytest.approx(expected, abs=1e-12)


def test_a_solve_starts_where_the_one_before_has_ended():
    flight = Flight(80)
    solved, graphs = threading.Event(), []

    def solver(graph):
        graphs.append(graph)
        return np.array([YawMotion(0.3, [1, 2, 3]).moved(pose) for pose in graph.poses])

    class Noticed(Ring):
        def put(self, record):
            super().put(record)
            solved.set()

    loop = bundle.ClosureLoop(Noticed(), solver=solver)
    keyframes = list(keyframes_of(flight, flight.states))
    for keyframe in keyframes[:3]:
        loop.put_keyframe(keyframe)
    loop.put_closure(closure_of(flight, 0, 40))
    assert solved.wait(PATIENCE)
    loop.put_keyframe(keyframes[3])
    loop.put_closure(closure_of(flight, 0, 60))
    assert loop.close(PATIENCE)
    first, second = graphs
    assert second.poses[:3] == pytest.approx(solver(first), abs=1e-12)
    assert second.poses[3] == pytest.approx(
        YawMotion(0.3, [1, 2, 3]).moved(np.asarray(keyframes[3].pose)), abs=1e-12
    )


def test_a_stalled_solve_delays_no_pose_and_its_correction_is_composed_in_shares():
    """The solve ends only once 4 s of poses are out: whoever waited for it would never end."""
    shares, before, stalled = 100, 200, 800
    count = before + stalled + 2 * shares
    flight = Flight(count)
    window = drifted(flight.states, YAW, SHIFT)
    publisher = flight.publisher(num_shares=shares)
    solving, published = threading.Event(), threading.Event()

    def solver(graph):
        solving.set()
        assert published.wait(PATIENCE), "poses waited for the solve"
        return bundle.solve(graph, num_threads=1).problem.poses

    loop = bundle.ClosureLoop(publisher.corrections, solver=solver)
    poses, spent = [], []
    try:
        for k in range(count):
            if k % KEYFRAME_EVERY == 0:
                loop.put_keyframe(Keyframe(flight.stamps[k], window[k, :7], 1e4))
                publisher.solutions.put(
                    Solution(flight.stamps[max(k - 1, 0)], window[max(k - 1, 0)])
                )
            if k == before:
                loop.put_closure(closure_of(flight, 0, before))
                assert solving.wait(PATIENCE)
            if k == before + stalled:
                assert all(pose.shift == pose.turn == 0 for pose in poses)
                assert loop.num_solves == 0
                published.set()
                assert loop.close(PATIENCE)  # the correction is there, or nothing comes any more
            begun = time.thread_time()
            poses.append(flight.publish(publisher, k))
            spent.append(time.thread_time() - begun)
    finally:
        published.set()
    assert loop.num_solves == 1
    assert loop.num_lost == 0
    # Its own work per pose, which no other thread and no load of the machine adds to.
    assert np.percentile(spent, 99) < 5e-3
    target = publisher.target
    whole = [np.linalg.norm(target.moved(window[k])[4:7] - window[k, 4:7]) for k in range(count)]
    assert max(whole) > 0.02
    for pose in poses[before + stalled :]:
        assert pose.shift <= 1.2 * max(whole) / shares
        assert pose.turn <= 1.001 * abs(target.yaw) / shares
    # The window drifts between its solutions; the publisher does not know by how much.
    expected = target.moved(window[count - 1])[4:7]
    assert poses[-1].state[4:7] == pytest.approx(expected, abs=0.02)
    assert np.linalg.norm(window[count - 1, 4:7] - expected) > 0.1


def test_a_window_that_misses_its_deadline_is_counted_and_drained_to_the_newest():
    solving, go_on, calls = threading.Event(), threading.Event(), []
    state = Flight(1).states[0]

    def solve(frames, deadline):
        calls.append((frames, deadline))
        solving.set()
        assert go_on.wait(PATIENCE)
        return Solution(frames[-1], state) if frames[-1] % 2 else None

    solutions = Ring()
    loop = bundle.WindowLoop(solve, solutions, budget=1e-9, capacity=8)
    loop.put(1)
    assert solving.wait(PATIENCE)
    for frame in range(2, 22):
        loop.put(frame)
    go_on.set()
    assert loop.close(PATIENCE)
    assert [frames for frames, _ in calls] == [[1], list(range(14, 22))]
    assert calls[0][1] < calls[1][1]
    assert loop.num_lost_frames == 12
    assert loop.num_solves == loop.num_late == 2
    assert [solution.timestamp_ns for solution in solutions.take_all()] == [1, 21]
    assert loop.longest > 0
    assert "2 solves" in repr(loop)


def test_a_window_in_time_is_not_late():
    loop = bundle.WindowLoop(lambda frames, deadline: None, Ring(), budget=PATIENCE)  # noqa: ARG005
    loop.put(0)
    assert loop.close(PATIENCE)
    assert loop.num_solves == 1
    assert loop.num_late == 0


@pytest.mark.parametrize("which", ["window", "closures"])
def test_what_a_thread_raises_comes_out_of_close(which):
    flight = Flight(40)

    def broken(*_):
        raise ZeroDivisionError("broken")

    if which == "window":
        loop = bundle.WindowLoop(broken, Ring())
        loop.put(0)
    else:
        loop = bundle.ClosureLoop(Ring(), solver=broken)
        for keyframe in keyframes_of(flight, flight.states):
            loop.put_keyframe(keyframe)
        loop.put_closure(closure_of(flight, 0, 40))
    with pytest.raises(ZeroDivisionError, match="broken"):
        loop.close(PATIENCE)
    assert loop.close(PATIENCE)


def test_misuse():
    flight = Flight(40)
    loop = bundle.ClosureLoop(Ring())
    first, second, *_ = keyframes_of(flight, flight.states)
    pose = np.r_[0, 0, 0, 1, 0, 0, 0.0]
    loop.put_keyframe(second)
    for call, word in (
        (lambda: loop.put_keyframe(first), "after"),
        (lambda: loop.put_keyframe(second), "after"),
        (lambda: loop.put_keyframe(pose), "Keyframe"),
        (lambda: loop.put_closure(first), "Closure"),
        (lambda: Keyframe(0, np.zeros(7)), "norm 0"),
        (lambda: Keyframe(0, pose * np.nan), "finite"),
        (lambda: Keyframe(0, pose, np.eye(3)), "information"),
        (lambda: Closure(5, 5, pose), "different"),
        (lambda: Closure(5, 6, pose[:6]), "measurement"),
        (lambda: bundle.ClosureLoop([]), "corrections"),
        (lambda: bundle.ClosureLoop(Ring(), solver=3), "function"),
        (lambda: bundle.WindowLoop(3, Ring()), "function"),
        (lambda: bundle.WindowLoop(len, Ring(), budget=0), "budget"),
        (lambda: bundle.WindowLoop(len, None), "solutions"),
    ):
        with pytest.raises(InputError, match=word):
            call()
    loop.put_closure(Closure(flight.stamps[0], 7, pose))
    assert loop.close(PATIENCE)
    assert loop.num_unknown == 1
    assert loop.num_solves == 0
    assert loop.error is None
    assert flight.stamps[1] - flight.stamps[0] == PERIOD_NS
    assert YawMotion().yaw == 0
