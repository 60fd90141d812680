"""Whole sequences through two loops: repeatable, corrected by closures, nothing waits in real time.

Closures say that their later end is elsewhere by a known turn and shift: what the graph is to find.
"""

import json
import threading

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.cli.main import main
from bundle.inertial.two_loops.closure_loop import Closure, ClosureLoop, load_closures
from bundle.inertial.two_loops.pose_publisher import YawMotion
from bundle.inertial.two_loops.replay import ProcessSolver, run_two_loops
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.io.sequences.trajectory_files import load_tum
from bundle.model.rigid_motions import inverse_poses, multiply_poses
from bundle.synthetic.synthetic_flight import synthesize_flight

TWIST = YawMotion(0.08, (0.5, -0.3, 0.2))


@pytest.fixture(scope="module")
def flight():
    return synthesize_flight(duration=4.0, rest=1.5, num_tracks=20, seed=2)


@pytest.fixture(scope="module")
def saved(flight, tmp_path_factory):
    """The folder of the flight."""
    folder = tmp_path_factory.mktemp("flight") / "s"
    save_sequence(flight.sequence, folder)
    return folder


def poses_at(flight, seconds):
    begin = int(flight.ground_truth.timestamps_ns[0])
    stamps = np.array([begin + round(1e9 * value) for value in seconds], np.int64)
    return stamps, states_at(flight.ground_truth, stamps)[:, :7]


def closure(flight, first, second, information=1e8):
    """True, but for a turn and shift of the later end: where the graph is to go.

    Both times lie between images, whose interpolation is the window's, too.
    """
    stamps, poses = poses_at(flight, [first, second])
    moved = TWIST.moved(poses[1])[None]
    return Closure(*stamps, multiply_poses(inverse_poses(poses[:1]), moved)[0], information)


@pytest.fixture(scope="module")
def plain(flight):
    return run_two_loops(flight.sequence, time_budget=10.0)


def test_without_closures_poses_are_the_window_propagated(flight, plain):
    odometry = run_odometry(flight.sequence, time_budget=10.0)
    np.testing.assert_array_equal(
        plain.odometry.trajectory.timestamps_ns, odometry.trajectory.timestamps_ns
    )
    np.testing.assert_array_equal(plain.odometry.trajectory.states, odometry.trajectory.states)
    found = plain.published
    samples = flight.sequence.imu_timestamps_ns
    begin = odometry.trajectory.timestamps_ns[3]  # the last image of the start
    np.testing.assert_array_equal(found.timestamps_ns, samples[samples > begin])
    # Of each image the solution is there at the next sample, and moves nothing but by its step.
    at = states_at(odometry.trajectory, odometry.trajectory.timestamps_ns)
    after = np.searchsorted(found.timestamps_ns, odometry.trajectory.timestamps_ns[4:-1], "right")
    step = np.linalg.norm(found.states[after, 4:7] - at[4:-1, 4:7], axis=1)
    assert step.max() < 0.02
    counts = plain.statistics
    assert counts.num_poses == len(found)
    assert counts.num_window_solves == len(odometry.trajectory) - 4
    assert counts.num_images_left_out == counts.num_lost == counts.num_solutions_refused == 0
    assert counts.num_corrections == counts.num_closures == 0
    assert counts.lateness is None
    assert counts.num_late is None
    assert plain.correction.yaw == 0
    assert f"{counts.num_poses} poses" in repr(plain)


def test_closures_move_what_is_published_and_nothing_else(flight, plain):
    given = [closure(flight, 1.013, 3.012), closure(flight, 1.013, 2.512)]
    result = run_two_loops(flight.sequence, closures=given, time_budget=10.0, num_shares=50)
    again = run_two_loops(flight.sequence, closures=given[::-1], time_budget=10.0, num_shares=50)
    np.testing.assert_array_equal(result.published.states, again.published.states)
    np.testing.assert_array_equal(
        result.odometry.trajectory.states, plain.odometry.trajectory.states
    )
    counts = result.statistics
    assert (counts.num_closures, counts.num_corrections, counts.num_graph_solves) == (2, 2, 2)
    assert counts.num_closures_unknown == 0
    moved = np.linalg.norm(result.published.states[:, 4:7] - plain.published.states[:, 4:7], axis=1)
    seconds = 1e-9 * (result.published.timestamps_ns - flight.ground_truth.timestamps_ns[0])
    assert moved[seconds < 2.5].max() < 1e-12
    expected = np.array([result.correction.moved(s) for s in plain.published.states])
    np.testing.assert_allclose(
        result.published.states[-20:, :10], expected[-20:, :10], rtol=0, atol=1e-9
    )
    assert result.correction.yaw == pytest.approx(TWIST.yaw, rel=0.15)
    # A share moves a pose by 1/50 of what is left, the pose itself moves on meanwhile.
    whole = np.linalg.norm(expected[:, 4:7] - plain.published.states[:, 4:7], axis=1)
    assert 0 < counts.largest_shift < 1.5 * whole.max() / 50
    assert 0 < counts.largest_turn < 1.1 * abs(result.correction.yaw) / 50


def test_closures_between_images_are_those_of_the_nearest_keyframes(flight):
    """True closures at any time become true ones of the keyframes, though both ends have moved."""
    graphs = []

    def solver(graph):
        graphs.append(graph)
        return graph.poses

    ends = [2.07, 3.037]
    stamps, (first, second) = poses_at(flight, ends)
    true = multiply_poses(inverse_poses(first[None]), second[None])[0]
    given = [Closure(*stamps, true, 1e8)]
    result = run_two_loops(flight.sequence, closures=given, solver=solver, time_budget=10.0)
    odometry = result.odometry
    keyframes = [*odometry.trajectory.timestamps_ns[:4].tolist()]
    keyframes += [record.timestamp_ns for record in odometry.keyframes[1:]]
    a, b = (keyframes[place] for place in graphs[0].edges[-1])
    assert abs(a - stamps[0]) == min(abs(t - stamps[0]) for t in keyframes) > 10_000_000
    assert abs(b - stamps[1]) == min(
        abs(t - stamps[1]) for t in keyframes[: 1 + keyframes.index(b)]
    )
    at = states_at(flight.ground_truth, np.array([a, b]))[:, :7]
    expected = multiply_poses(inverse_poses(at[:1]), at[1:])[0]
    assert np.linalg.norm(expected[4:] - true[4:]) > 0.01
    found = graphs[0].measurements[-1]
    np.testing.assert_allclose(found[4:], expected[4:], rtol=0, atol=4e-3)
    assert abs(found[:4] @ expected[:4]) > np.cos(np.radians(0.3) / 2)


def test_longer_ways_are_less_certain(flight, monkeypatch):
    handed = []
    put = ClosureLoop.put_keyframe

    def noted(loop, keyframe):
        handed.append(keyframe)
        return put(loop, keyframe)

    monkeypatch.setattr(ClosureLoop, "put_keyframe", noted)
    run_two_loops(flight.sequence, time_budget=10.0)
    places = np.array([keyframe.pose[4:7] for keyframe in handed])
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    sigmas = np.array([np.diag(keyframe.information) ** -0.5 for keyframe in handed[1:]])
    assert lengths.max() > 0.05
    np.testing.assert_allclose(sigmas[:, 3:], np.repeat([2e-3 + 0.01 * lengths], 3, axis=0).T)
    np.testing.assert_allclose(sigmas[:, :3], np.radians(0.1))


def test_closures_out_of_reach_are_counted(flight, plain):
    begin = int(flight.ground_truth.timestamps_ns[0])
    pose = np.r_[0, 0, 0, 1, 0, 0, 0.0]
    given = [
        Closure(begin - 10**9, begin + 3 * 10**9, pose),
        Closure(begin + 10**9, begin + 90 * 10**9, pose),
        Closure(begin + 2_600_000_000, begin + 2_601_000_000, pose),
    ]
    result = run_two_loops(flight.sequence, closures=given, time_budget=10.0)
    assert result.statistics.num_closures_unknown == 3
    assert result.statistics.num_corrections == 0
    np.testing.assert_array_equal(result.published.states, plain.published.states)


def test_in_real_time_a_stalled_graph_holds_up_nothing(flight):
    """The graph's solve ends only after all poses are out: whoever waited would never end."""
    go_on, waited = threading.Event(), []

    def solver(graph):
        waited.append(go_on.wait(60))
        return graph.poses

    def progress(done, count):
        if done > 0.95 * count:
            go_on.set()
        return True

    result = run_two_loops(
        flight.sequence, closures=[closure(flight, 1.0, 2.0)], real_time=True, solver=solver,
        progress=progress,
    )  # fmt: skip
    counts = result.statistics
    assert waited == [True]
    assert counts.real_time
    assert set(counts.lateness) == {"p50", "p95", "max"}
    assert 0 <= counts.num_late <= counts.num_poses
    assert counts.num_window_solves + counts.num_images_left_out + counts.num_lost >= 20
    assert counts.longest_window_solve > 0
    assert np.isfinite(result.published.states).all()


def test_a_process_solves_as_a_thread_does():
    rng = np.random.default_rng(1)
    poses = np.hstack([np.tile([0, 0, 0, 1.0], (6, 1)), rng.normal(size=(6, 3))])
    edges = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0)])
    between = multiply_poses(inverse_poses(poses[edges[:, 0]]), poses[edges[:, 1]])
    between[:, 4:] += 0.1 * rng.normal(size=(6, 3))
    graph = bundle.PoseGraph(
        poses=poses, edges=edges, measurements=between,
        information=np.tile(np.eye(6), (6, 1, 1)), fixed=np.arange(6) == 0,
    )  # fmt: skip
    solver = ProcessSolver()
    try:
        expected = bundle.solve(graph, num_threads=1).problem.poses
        for _ in range(2):
            np.testing.assert_array_equal(solver(graph), expected)
        wrong = graph.replace(information=-graph.information)
        with pytest.raises(RuntimeError, match="InputError"):
            solver(wrong)
        np.testing.assert_array_equal(solver(graph), expected)  # it goes on
        with pytest.raises(InputError, match="graph"):
            solver(poses)
        solver._process.kill()
        with pytest.raises(RuntimeError, match="ended"):
            solver(graph)
    finally:
        solver.close()


LINE = "1000000000,2000000000,1,2,3,0,0,0.6,0.8,0.1,2"


def test_closures_are_read(tmp_path):
    table = tmp_path / "closures.csv"
    table.write_text(
        f"first_timestamp_ns,b,x,y,z,i,j,k,w,p,r\n5,9000000000,0,0,0,0,0,0,1,1,1\n{LINE}\n"
    )
    first, second = load_closures(table)
    assert (first.first_ns, first.second_ns, second.second_ns) == (10**9, 2 * 10**9, 9 * 10**9)
    np.testing.assert_allclose(first.measurement, [0, 0, 0.6, 0.8, 1, 2, 3])
    expected = np.repeat([np.radians(2), 0.1], 3) ** -2.0
    np.testing.assert_allclose(first.information, np.diag(expected))
    poses = np.array([[0, 0, 0, 1.0, 0, 0, 0], [0, 0, 0.6, 0.8, 1, 2, 3]])
    graph = bundle.PoseGraph(
        poses=poses, edges=np.array([[0, 1]]), measurements=poses[1:],
        information=np.diag(expected)[None], ids=np.array([10**9, 2 * 10**9]),
    )  # fmt: skip
    bundle.save(graph, tmp_path / "closures.g2o")
    (same,) = load_closures(tmp_path / "closures.g2o")
    assert (same.first_ns, same.second_ns) == (first.first_ns, first.second_ns)
    np.testing.assert_allclose(same.measurement, first.measurement)
    np.testing.assert_allclose(same.information, first.information)


@pytest.mark.parametrize(
    "line",
    [
        "",
        LINE.replace("0.8", "0.9"),
        LINE.replace("0.8", "nan"),
        LINE.replace("0.1", "0"),
        LINE.replace("0.1,2", "0.1"),
        LINE.replace("2000000000", "1000000000"),
        LINE.replace("2000000000", "word"),
        "EDGE_SE2 1 2 0 0 0 1 0 0 1 0 1",
    ],
)
def test_bad_closures_are_one_line_and_nothing_is_written(line, saved, tmp_path, capsys):
    table = tmp_path / "closures"
    table.write_text(line + "\n")
    written = [tmp_path / "x.tum", tmp_path / "p.tum"]
    arguments = ["vio", saved, "-o", written[0], "--publish", written[1]]
    assert main([*map(str, arguments), "--loops", str(table), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert "closures" in said
    assert not any(path.exists() for path in written)


def test_the_command(flight, tmp_path, capsys):
    save_sequence(flight.sequence, tmp_path / "s")
    first, second = (int(t) for t in poses_at(flight, [1.6, 3.0])[0])
    pose = np.asarray(closure(flight, 1.6, 3.0).measurement)
    numbers = ",".join(map(str, [*pose[4:], *pose[:4], 0.001, 0.01]))
    (tmp_path / "loops.csv").write_text(f"{first},{second},{numbers}\n")
    arguments = ["vio", tmp_path / "s", "-o", tmp_path / "x.tum", "--publish", tmp_path / "p.tum"]
    arguments += ["--loops", tmp_path / "loops.csv", "--json", tmp_path / "r.json", "--quiet"]
    assert main([*map(str, arguments), "--time-budget", "10", "--verbose"]) == 0
    found = json.loads((tmp_path / "r.json").read_text())["two_loops"]
    assert (found["num_closures"], found["num_corrections"]) == (1, 1)
    assert found["correction"]["yaw"] == pytest.approx(TWIST.yaw, rel=0.15)
    assert found["lateness"] is None
    published = load_tum(tmp_path / "p.tum")
    assert len(published) == found["num_poses"] > len(load_tum(tmp_path / "x.tum"))
    assert "corrections" in capsys.readouterr().out
    for wrong in (["--loops", "x"], ["--real-time"]):
        alone = [str(word) for word in arguments[:4]]
        assert main([*alone, *wrong, "--quiet"]) == 2
        assert "--publish" in capsys.readouterr().err


def test_misuse_and_an_end_in_between(flight):
    for changes, word in (
        ({"closures": [3]}, "closures"),
        ({"num_shares": 0}, "num_shares"),
        ({"window": 1}, "window"),
    ):
        with pytest.raises(InputError, match=word):
            run_two_loops(flight.sequence, **changes)
    short = run_two_loops(flight.sequence, progress=lambda done, _: done < 500)
    assert 0 < short.statistics.num_poses < 500
    assert short.odometry.message == "stopped by the caller"

    def broken(_):
        raise ZeroDivisionError("broken")

    threads = threading.active_count()
    with pytest.raises(ZeroDivisionError, match="broken"):
        run_two_loops(flight.sequence, closures=[closure(flight, 1.0, 2.0)], solver=broken)
    assert threading.active_count() == threads
