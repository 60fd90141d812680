"""Covariances of pose graphs: dense algebra, GTSAM, gauges, losses, what is refused."""

import json
import pickle

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.graphs.pose_graphs.lie_groups import adjoints
from tests import scenes
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.test_wrong_closures import certain_loop, with_wrong_closures

CASES = [(d, e) for d in (2, 3) for e in ("log", "g2o")]


def solved(dimension, error="log", **kinds):
    return bundle.solve(graphs.loop(dimension, **kinds), error=error).problem


@pytest.mark.parametrize(("dimension", "error"), CASES)
def test_blocks_are_those_of_the_dense_inverse(dimension, error):
    graph = solved(dimension, error, num_poses=7, num_closures=4)
    d, jacobian = graph.tangent_size, graphs.dense_jacobian(graph, error)[0]
    inverse = np.zeros((jacobian.shape[1],) * 2)
    inverse[d:, d:] = np.linalg.inv((jacobian.T @ jacobian)[d:, d:])
    pairs = [(2, 6), (0, 5), (3, 2), (4, 0)]
    cov = bundle.covariance(graph, error=error, relative=pairs)
    close = {"rtol": 1e-6, "atol": 1e-7 * np.abs(inverse).max()}
    np.testing.assert_allclose(cov.pose_covariance, graphs.blocks(inverse, d), **close)
    assert not cov.pose(0).any() and cov.held_pose_ids == (0,)
    for a, b in pairs:
        back = graphs.pose_of(
            np.linalg.inv(graphs.matrix(graph.poses[b])) @ graphs.matrix(graph.poses[a])
        )
        moved = np.zeros((d, len(inverse)))
        moved[:, d * b : d * b + d] = np.eye(d)
        moved[:, d * a : d * a + d] -= adjoints(back[None])[0]
        np.testing.assert_allclose(cov.relative(a, b), moved @ inverse @ moved.T, **close)
    inner = bundle.covariance(graph, error=error, gauge="inner", relative=pairs)
    pseudo = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-9, hermitian=True)
    np.testing.assert_allclose(inner.pose_covariance, graphs.blocks(pseudo, d), **close)
    np.testing.assert_allclose(inner.relative_covariance, cov.relative_covariance, rtol=1e-8)
    assert np.trace(inner.pose_covariance.sum(axis=0)) < np.trace(cov.pose_covariance.sum(axis=0))


@pytest.mark.parametrize("num_poses", [2, 5])
def test_without_edges_no_sigma_is_known(num_poses):
    none = {
        "edges": np.zeros((0, 2), int),
        "measurements": np.zeros((0, 3)),
        "information": np.zeros((0, 3, 3)),
    }
    poses = np.zeros((num_poses, 3))
    with pytest.raises(bundle.InputError, match=r"^graph: .*no edge"):
        bundle.covariance(bundle.PoseGraph(poses=poses, **none))
    with pytest.raises(bundle.InputError, match=r"^graph: .*no edge"):
        bundle.inspect(bundle.PoseGraph(poses=poses, **none))
    fixed = bundle.PoseGraph(poses=poses, fixed=np.ones(num_poses, bool), **none)
    assert not bundle.covariance(fixed).pose_covariance.any()


@pytest.mark.parametrize("dimension", [2, 3])
def test_blocks_are_those_of_gtsam(dimension):
    gtsam = pytest.importorskip("gtsam")
    graph = solved(dimension)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def pose(x):
        if dimension == 2:
            return gtsam.Pose2(*x)
        return gtsam.Pose3(graphs.matrix(x))

    kind = "Pose2" if dimension == 2 else "Pose3"
    d = graph.tangent_size
    for k, x in enumerate(graph.poses):
        values.insert(k, pose(x))
    held = gtsam.noiseModel.Constrained.All(d)
    factors.add(getattr(gtsam, f"PriorFactor{kind}")(0, pose(graph.poses[0]), held))
    for (i, j), z, omega in zip(graph.edges, graph.measurements, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(omega)
        factors.add(getattr(gtsam, f"BetweenFactor{kind}")(int(i), int(j), pose(z), noise))
    marginals = gtsam.Marginals(factors, values)
    cov = bundle.covariance(graph)
    for k in range(1, graph.num_poses):
        expected = marginals.marginalCovariance(k)
        np.testing.assert_allclose(cov.pose(k), expected, atol=1e-7 * np.abs(expected).max())


def test_a_gauge_that_floats_far_away_is_no_worse():
    near = solved(3)
    motion = np.array([0.1, 0.2, 0.3, np.sqrt(0.86), 3e5, -2e5, 1e5])
    far = near.replace(
        poses=np.array(
            [graphs.pose_of(graphs.matrix(motion) @ graphs.matrix(x)) for x in near.poses]
        )
    )
    for gauge in ("first", "inner"):
        one, other = (bundle.covariance(g, gauge=gauge).pose_covariance for g in (near, far))
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-7 * one.max())


@pytest.mark.parametrize("loss", ["huber", "cauchy", "dcs", "geman_mcclure", "gnc_tls"])
def test_a_loss_never_makes_anything_more_certain(loss):
    graph = with_wrong_closures(certain_loop(3, num_poses=20, num_closures=12, noise=0.005), 3)
    result = bundle.solve(graph, loss=loss)
    sure, robust = bundle.covariance(result.problem), bundle.covariance(result)
    for one, other in zip(sure.pose_covariance, robust.pose_covariance, strict=True):
        assert np.linalg.eigvalsh(other - one)[0] >= -1e-9 * max(np.trace(other), 1e-30)
    assert np.trace(robust.pose(19)) > 1.0001 * np.trace(sure.pose(19))
    by_options = bundle.covariance(result.problem, result.options)
    np.testing.assert_allclose(by_options.pose_covariance, robust.pose_covariance, rtol=1e-9)


def test_scale_and_degrees_of_freedom():
    graph = solved(2)
    unit, scaled = bundle.covariance(graph), bundle.covariance(graph, scale="sigma0")
    assert unit.dof == 3 * (17 - 11)
    chi2 = graphs.chi2_by_matrices(graph).sum()
    np.testing.assert_allclose(unit.sigma0, np.sqrt(chi2 / unit.dof), rtol=1e-9)
    expected = unit.sigma0**2 * unit.pose_covariance
    np.testing.assert_allclose(scaled.pose_covariance, expected, rtol=1e-12)
    chain = graphs.loop(2, num_closures=0)
    with pytest.raises(bundle.InputError, match=r"^scale: expected degrees of freedom"):
        bundle.covariance(bundle.solve(chain).problem, scale="sigma0")


def test_fixed_poses_and_components():
    graph = graphs.loop(2, start_noise=0, num_closures=0)
    split = graph.replace(
        edges=np.delete(graph.edges, 5, 0),
        measurements=np.delete(graph.measurements, 5, 0),
        information=np.delete(graph.information, 5, 0),
        edge_lines=None,
    )
    cov = bundle.covariance(split)
    assert cov.held_pose_ids == (0, 6) and not cov.pose(6).any() and cov.pose(5).any()
    assert any("2 components" in note for note in cov.notes)
    with pytest.raises(bundle.InputError, match=r"^relative: expected poses that edges"):
        bundle.covariance(split, relative=[(3, 8)])
    with pytest.raises(bundle.InputError, match=r"^gauge: expected a fixed pose"):
        bundle.covariance(split, gauge="none")
    held = split.replace(fixed=np.isin(np.arange(12), [2, 9]))
    free = bundle.covariance(held, gauge="none", relative=[(3, 8)])
    assert free.held_pose_ids == () and not free.pose(9).any() and free.relative(3, 8).any()
    all_fixed = bundle.covariance(split.replace(fixed=np.ones(12, bool)))
    assert not all_fixed.pose_covariance.any()
    alone = bundle.PoseGraph(
        poses=[[0, 0, 0.0]],
        edges=np.zeros((0, 2), int),
        measurements=np.zeros((0, 3)),
        information=np.zeros((0, 3, 3)),
    )
    assert not bundle.covariance(alone, gauge="inner").pose_covariance.any()


def test_what_is_not_determined_is_refused():
    graph = graphs.loop(3, num_closures=0)
    information = graph.information.copy()
    information[4] = np.diag([1, 1, 0, 1, 1, 1.0])
    with pytest.raises(
        bundle.InputError, match=r"^graph: expected edges that .* poses 5, 6, 7 and"
    ):
        bundle.covariance(graph.replace(information=information))


def test_notes_on_a_start_that_is_no_minimum():
    graph = graphs.loop(2)
    assert any("lower the cost" in note for note in bundle.covariance(graph).notes)
    assert bundle.covariance(bundle.solve(graph)).notes == ()


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"gauge": "two_cameras"}, "gauge"),
        ({"scale": "x"}, "scale"),
        ({"relative": [(0, 99)]}, "relative"),
        ({"relative": [(1, 1)]}, "relative"),
        ({"relative": [3]}, "relative"),
        ({"of": "poses"}, "of"),
        ({"robust": "sandwich"}, "robust"),
        ({"loss": "x"}, "loss"),
        ({"constraints": ["image 1: position fixed"]}, "constraints"),
        ({"options": bundle.SolveOptions()}, "options"),
    ],
)
def test_wrong_arguments(arguments, name):
    with pytest.raises(bundle.InputError, match=rf"^{name}: "):
        bundle.covariance(graphs.loop(2), **arguments)
    with pytest.raises(bundle.InputError, match=r"^pose: "):
        bundle.covariance(graphs.loop(2)).pose(99)


def test_the_number_of_threads_changes_nothing():
    graph = solved(3, num_poses=30, num_closures=20)
    one, two = (_core.graph_covariance(graph, "log", True, True, [], n) for n in (1, 2))
    for name in ("poses", "edge_test", "edge_redundancy"):
        np.testing.assert_array_equal(one[name], two[name])


def test_the_command(tmp_path, capsys):
    from bundle.cli.main import main

    graph = solved(3)
    bundle.save(graph, tmp_path / "x.g2o")
    words = ["covariance", str(tmp_path / "x.g2o"), "-o", str(tmp_path / "c.npz")]
    words += ["--threads", "1", "--quiet"]
    report = ["--json", str(tmp_path / "r.json")]
    assert main([*words, *report, "--relative", "1:7", "--gauge", "inner"]) == 0
    assert "gauge inner" in capsys.readouterr().out
    expected = bundle.covariance(graph, relative=[(1, 7)], gauge="inner")
    with np.load(tmp_path / "c.npz") as file:
        arrays = dict(file)
    np.testing.assert_array_equal(arrays["pose_ids"], graph.ids)
    assert arrays["held_pose_ids"].tolist() == [0] and arrays["camera_covariance"].size == 0
    of_images = bundle.covariance(scenes.make_problem())
    assert "held_pose_ids" not in of_images._arrays() and not of_images.is_of_graph
    np.testing.assert_allclose(arrays["pose_covariance"], expected.pose_covariance, rtol=1e-9)
    found = json.loads((tmp_path / "r.json").read_text())
    assert found["command"] == "covariance" and found["dof"] == expected.dof
    assert found["relative"][0]["ids"] == [1, 7] and found["robust"] == "weights"
    for flags in (["--of", "poses"], ["--gauge", "three-points"], ["--fix-images", "1"]):
        (tmp_path / "c.npz").unlink(missing_ok=True)
        assert main([*words, *flags]) == 2
        line = capsys.readouterr().err
        assert line.startswith(f"error: {flags[0]}: ") and line.count("\n") == 1
        assert not (tmp_path / "c.npz").exists()
    again = pickle.loads(pickle.dumps(expected))
    np.testing.assert_array_equal(again.pose(3), expected.pose(3))
    assert "12 poses" in repr(expected)
