"""Solves against a dense Gauss-Newton on errors of matrices, and against toys and known optima."""

import numpy as np
import pytest

import bundle
from bundle import _core
from tests.graphs.pose_graphs import graphs

TIGHT = {"function_tolerance": 1e-15, "parameter_tolerance": 1e-14, "gradient_tolerance": 1e-12}
CASES = [(d, e) for d in (2, 3) for e in ("log", "g2o")]


def dense_gauss_newton(graph, error):
    """Minimise with the first pose held: errors of matrices, central differences, dense algebra."""
    d = graph.tangent_size
    manifold = "se2" if graph.dimension == 2 else "se3"
    roots = np.linalg.cholesky(graph.information).transpose(0, 2, 1)
    poses = [graph.poses[0], *(np.array(pose) for pose in graph.poses[1:])]

    def edge(k, x_i, x_j):
        return roots[k] @ graphs.error_by_matrices(error, x_i, x_j, graph.measurements[k])

    for _ in range(12):
        jacobian = np.zeros((d * graph.num_edges, d * graph.num_poses))
        residual = np.zeros(d * graph.num_edges)
        for k, pair in enumerate(graph.edges):
            rows = slice(d * k, d * k + d)
            ends = [poses[p] for p in pair]
            residual[rows] = edge(k, *ends)
            for side, pose in enumerate(pair):
                for c in range(d):
                    found = []
                    for sign in (1, -1):
                        moved = list(ends)
                        moved[side] = _core.retract(
                            manifold, ends[side], sign * 1e-6 * np.eye(d)[c]
                        )
                        found.append(edge(k, *moved))
                    jacobian[rows, d * pose + c] = (found[0] - found[1]) / 2e-6
        step = np.linalg.lstsq(jacobian[:, d:], -residual, rcond=None)[0].reshape(-1, d)
        for p in range(1, graph.num_poses):
            poses[p] = _core.retract(manifold, poses[p], step[p - 1])
        if np.abs(step).max() < 1e-9:
            break
    return np.array(poses)


@pytest.mark.parametrize(("dimension", "error"), CASES)
def test_optima_are_those_of_a_dense_gauss_newton(dimension, error):
    """It starts at the poses of the fused backend, and would leave them for a lower cost."""
    graph = graphs.loop(dimension, num_poses=7, num_closures=4)
    solved = {
        backend: bundle.solve(graph, error=error, backend=backend, init="file", **TIGHT)
        for backend in ("fused", "ceres")
    }
    found = solved["fused"].problem.poses
    expected = dense_gauss_newton(graph.replace(poses=found), error)
    chi2 = graphs.chi2_by_matrices(graph.replace(poses=expected), error).sum()
    for backend, result in solved.items():
        assert result.summary.termination_type == "CONVERGENCE"
        assert result.summary.backend_used == backend.upper()
        start = graphs.chi2_by_matrices(graph, error)
        np.testing.assert_allclose(result.chi2_before, start, rtol=1e-9)
        np.testing.assert_allclose(result.summary.chi2_initial, start.sum(), rtol=1e-11)
        np.testing.assert_allclose(result.summary.chi2_final, chi2, rtol=1e-9)
        np.testing.assert_allclose(result.summary.final_cost, chi2 / 2, rtol=1e-9)
        for found, pose in zip(result.problem.poses, expected, strict=True):
            np.testing.assert_allclose(graphs.matrix(found), graphs.matrix(pose), atol=1e-6)
        np.testing.assert_array_equal(result.problem.poses[0], graph.poses[0])
        assert result.summary.num_gauge_freedoms == graph.tangent_size


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("strategy", ["dogleg", "subspace_dogleg"])
def test_every_strategy_takes_the_steps_of_ceres(dimension, strategy):
    graph = graphs.loop(dimension, start_noise=0.3, seed=2)
    options = {"trust_region_strategy_type": strategy, **TIGHT}
    best = bundle.solve(graph, **TIGHT).summary.chi2_final
    found = [bundle.solve(graph, backend=b, **options) for b in ("fused", "ceres")]
    for result in found:
        np.testing.assert_allclose(result.summary.chi2_final, best, rtol=1e-9)
    ours, theirs = (result.iterations["cost"][:5] for result in found)
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)


def test_levenberg_marquardt_takes_the_steps_of_ceres():
    graph = graphs.loop(3, start_noise=0.5, seed=11)
    options = {"trust_region_strategy_type": "levenberg_marquardt", **TIGHT}
    ours, theirs = (bundle.solve(graph, backend=b, **options) for b in ("fused", "ceres"))
    # Near the minimum, where costs differ by rounding, steps are accepted by chance.
    count = min(
        int(np.argmax(np.abs(run.iterations["cost_change"][1:]) < 1e-12 * run.summary.final_cost))
        for run in (ours, theirs)
    )
    assert count >= 4
    count += 1  # the start
    for name in ("cost", "trust_region_radius"):
        np.testing.assert_allclose(
            ours.iterations[name][:count], theirs.iterations[name][:count], rtol=1e-6, atol=1e-6
        )


def test_an_error_in_a_cycle_goes_to_all_edges_alike():
    """Four poses on a line, a closure of -2.8 where -3 was walked: each edge takes a quarter."""
    graph = bundle.PoseGraph(
        poses=[[k, 0, 0] for k in range(4)],
        edges=[[0, 1], [1, 2], [2, 3], [3, 0]],
        measurements=[[1, 0, 0], [1, 0, 0], [1, 0, 0], [-2.8, 0, 0]],
        information=np.tile(np.eye(3), (4, 1, 1)),
    )
    result = bundle.solve(graph, init="file", **TIGHT)
    np.testing.assert_allclose(result.problem.poses[:, 0], [0, 0.95, 1.9, 2.85], atol=1e-12)
    np.testing.assert_allclose(result.summary.initial_cost, 0.02, rtol=1e-12)
    np.testing.assert_allclose(result.summary.final_cost, 0.005, rtol=1e-12)
    np.testing.assert_allclose(result.chi2_after, 0.0025, rtol=1e-9)


def test_no_bit_depends_on_the_number_of_threads():
    graph = graphs.loop(2, num_poses=700, num_closures=200, start_noise=0.05, seed=6)
    poses = [bundle.solve(graph, num_threads=n).problem.poses for n in (1, 2)]
    np.testing.assert_array_equal(*poses)


@pytest.mark.parametrize("ordering", ["amd", "metis", "natural"])
def test_orderings_change_the_factor_and_not_the_result(ordering):
    graph = graphs.loop(3, num_poses=40, num_closures=30, seed=9)
    best = bundle.solve(graph)
    result = bundle.solve(graph, ordering=ordering)
    assert result.summary.factor_ordering == ordering
    assert result.summary.num_factor_nonzeros >= best.summary.num_factor_nonzeros
    np.testing.assert_allclose(result.summary.chi2_final, best.summary.chi2_final, rtol=1e-9)


def test_fixed_poses_stay_bit_by_bit_and_take_the_place_of_the_gauge():
    graph = graphs.loop(3)
    poses = graph.poses.copy()
    poses[:, :4] *= 1.7  # no unit quaternions
    graph = graph.replace(poses=poses, fixed=np.isin(np.arange(12), (3, 7)))
    for backend in ("fused", "ceres"):
        result = bundle.solve(graph, backend=backend)
        np.testing.assert_array_equal(result.problem.poses[[3, 7]], graph.poses[[3, 7]])
        assert (result.problem.poses[0] != graph.poses[0]).any()
        assert result.summary.num_gauge_freedoms == 0 and result.summary.held_pose_ids == ()
        norms = np.linalg.norm(result.problem.poses[[0, 5], :4], axis=1)
        np.testing.assert_allclose(norms, 1, rtol=1e-14)


def test_components_float_apart_each_with_a_gauge_of_its_own():
    one, other = graphs.loop(2, seed=1), graphs.loop(2, seed=2)
    both = bundle.PoseGraph(
        poses=np.concatenate([one.poses, other.poses, [[5.0, 5, 5]]]),
        edges=np.concatenate([one.edges, other.edges + 12]),
        measurements=np.concatenate([one.measurements, other.measurements]),
        information=np.concatenate([one.information, other.information]),
    )
    for backend in ("fused", "ceres"):
        result = bundle.solve(both, backend=backend, **TIGHT)
        assert result.summary.num_components == 3 and result.summary.num_gauge_freedoms == 9
        assert result.summary.held_pose_ids == (0, 12, 24)
        assert "several_components" in result.summary.warning_kinds
        apart = sum(bundle.solve(g, **TIGHT).summary.chi2_final for g in (one, other))
        np.testing.assert_allclose(result.summary.chi2_final, apart, rtol=1e-9)


def test_one_pose_and_graphs_without_edges_have_nothing_to_refine():
    empty = {"edges": np.zeros((0, 2), int), "measurements": np.zeros((0, 3))}
    for poses in ([[1.0, 2, 3]], [[1.0, 2, 3], [4, 5, 6]]):
        graph = bundle.PoseGraph(poses=poses, information=np.zeros((0, 3, 3)), **empty)
        for backend in ("fused", "ceres"):
            result = bundle.solve(graph, backend=backend)
            assert result.summary.termination_type == "CONVERGENCE"
            assert result.summary.chi2_final == 0
            np.testing.assert_array_equal(result.problem.poses, poses)


def test_directions_without_information_are_no_error():
    """Odometry that knows no angle, beside a compass between all poses and the first."""
    graph = graphs.loop(2, num_closures=11)
    edges, information = graph.edges.copy(), np.tile(np.diag([1.0, 1, 0]), (22, 1, 1))
    edges[11:] = [[0, k] for k in range(1, 12)]
    information[11:] = np.diag([0, 0, 4.0])
    result = bundle.solve(graph.replace(edges=edges, information=information), **TIGHT)
    assert result.summary.termination_type == "CONVERGENCE"
    assert result.summary.chi2_final < 1e-15 * result.summary.chi2_initial


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_a_loss_on_closures_forgives_a_wrong_one(loss):
    graph = graphs.loop(2, num_poses=20, num_closures=10, noise=0.001, start_noise=0.01, seed=3)
    clean = bundle.solve(graph, **TIGHT)
    wrong = graph.measurements.copy()
    wrong[24] += [4, 3, 1]
    bad = graph.replace(measurements=wrong)
    plain = bundle.solve(bad)

    def distance(result):
        return np.abs(result.problem.poses - clean.problem.poses).max()

    for backend in ("fused", "ceres"):
        robust = bundle.solve(bad, loss=loss, loss_scale=0.05, backend=backend)
        assert distance(robust) < 0.1 * distance(plain)
        assert np.argmax(robust.chi2_after) == 24
        assert robust.summary.final_cost < robust.summary.chi2_final / 2


def test_a_loss_is_on_closures_unless_it_is_on_all():
    graph = graphs.loop(2, start_noise=0.3)
    chi2 = bundle.pose_graph_chi2(graph)
    rho = np.log1p(chi2)
    closure = graph.is_closure
    assert closure.any() and not closure.all()
    expected = {"closures": np.where(closure, rho, chi2), "all": rho}
    for where, values in expected.items():
        for backend in ("fused", "ceres"):
            found = bundle.solve(
                graph, loss="cauchy", loss_on=where, backend=backend, max_num_iterations=0
            )
            np.testing.assert_allclose(found.summary.initial_cost, values.sum() / 2, rtol=1e-12)


def test_progress_is_told_and_may_stop():
    seen = []

    def progress(record):
        seen.append(record["iteration"])
        if len(seen) == 2:
            raise KeyboardInterrupt

    result = bundle.solve(graphs.loop(3, start_noise=0.5), progress=progress)
    assert seen == [0, 1] and result.summary.interrupted
    with pytest.raises(bundle.InputError, match=r"^progress: "):
        bundle.solve(graphs.loop(3), progress="bar")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"init": "chordel"}, "^init: expected one of"),
        ({"error": "l2"}, "^error: expected one of"),
        ({"loss_scale": 2.0}, "^loss_scale: valid only with loss="),
        ({"refine": ("poses",)}, "there is no option"),
        ({"priors": [1]}, "^priors: expected none for a pose graph"),
        ({"options": bundle.SolveOptions()}, "^options: expected PoseGraphOptions"),
    ],
)
def test_options_that_do_not_exist_are_refused(given, message):
    with pytest.raises(bundle.InputError, match=message):
        bundle.solve(graphs.loop(2), **given)


def test_information_of_zero_on_all_edges_is_a_warning():
    graph = graphs.loop(2)
    for information, is_free in ((0 * graph.information, True), (graph.information, False)):
        summary = bundle.solve(graph.replace(information=information)).summary
        assert ("free_directions" in summary.warning_kinds) == is_free
