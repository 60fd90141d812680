"""Factor graphs under compare: the same problem both ways, any other graph, refusals."""

import numpy as np
import pytest

import bundle
from tests.analysis.uncertainty.test_factor_graph_covariance import landmarks
from tests.graphs.factors import both_ways
from tests.graphs.pose_graphs import graphs

pytestmark = pytest.mark.usefixtures("unpredicted")


def test_a_pose_graph_has_the_rows_of_its_file(tmp_path):
    graph = graphs.loop(2)
    graph = graph.replace(fixed=np.arange(graph.num_poses) == 0)
    bundle.save(graph, tmp_path / "x.g2o")
    theirs = bundle.compare(tmp_path / "x.g2o", repeat=1, threads=[1])
    ours = bundle.compare(both_ways.of_pose_graph(graph), repeat=1, threads=[1])
    assert [run.method for run in ours.runs] == [run.method for run in theirs.runs]
    for one, other in zip(ours.runs, theirs.runs, strict=True):
        np.testing.assert_allclose(one.final_cost, other.final_cost, rtol=1e-9)
        np.testing.assert_allclose(one.chi2_final, other.chi2_final, rtol=1e-9)
        assert one.num_steps == other.num_steps


def test_reprojections_have_the_rows_of_their_problem():
    problem = bundle.synthesize(bundle.SceneOptions(num_images=5, num_points=30, seed=2)).problem
    chosen = {
        "solvers": ["dense_schur", "sparse_normal_cholesky"],
        "backends": ["fused", "ceres"],
        "threads": [1],
        "repeat": 1,
    }
    theirs = bundle.compare(problem, gauge="none", cheirality="algebraic", **chosen)
    ours = bundle.compare(both_ways.of_problem(problem, held=(1, 2)), **chosen)
    assert [run.method for run in ours.runs] == [run.method for run in theirs.runs]
    for one, other in zip(ours.runs, theirs.runs, strict=True):
        np.testing.assert_allclose(one.final_cost, other.final_cost, rtol=1e-9)


def test_any_other_graph_is_compared_by_ceres_and_by_qr():
    found = bundle.compare(landmarks(), repeat=1, threads=[1])
    names = [run.method.name for run in found.runs]
    assert names == [
        "sparse-normal-cholesky levenberg-marquardt",
        "sparse-normal-cholesky gauss-newton",
        "sparse-normal-cholesky dogleg",
        "sparse-normal-cholesky subspace-dogleg",
        "dense-normal-cholesky levenberg-marquardt",
        "square-root levenberg-marquardt",
    ]
    usable = [run for run in found.runs if not run.failure]
    best = min(run.final_cost for run in usable)
    assert found.recommended is not None and found.gap(usable[0]) < 1e-6 < best
    assert found.command.startswith("graph.solve(")
    solved = eval(found.command, {"graph": landmarks()})
    np.testing.assert_allclose(solved.summary.final_cost, best, rtol=1e-6)
    for run in usable:
        # 1/2 rho <= 1/2 r^2
        assert run.num_steps > 0 and run.chi2_final >= 2 * run.final_cost * (1 - 1e-9)


def test_the_stated_problem_solves_to_the_same_values():
    graph = both_ways.of_pose_graph(graphs.loop(3, num_poses=8))
    poses = graph.as_pose_graph()
    solved = bundle.solve(poses, init="file").problem
    values = graph.solve(function_tolerance=1e-12, max_num_iterations=100).values
    for key, pose in zip(graph.keys, solved.poses, strict=True):
        sign = np.sign(pose[3] * values[key][3])
        np.testing.assert_allclose(np.append(sign * pose[:4], pose[4:]), values[key], atol=1e-5)
    problem = bundle.synthesize(bundle.SceneOptions(num_images=5, num_points=30, seed=2)).problem
    first = int(problem.image_ids[0])
    reprojections = both_ways.of_problem(problem, fixed_images=(first,), held=(1, 2))
    summary = bundle.solve(*reprojections.as_problem()).summary
    np.testing.assert_allclose(
        summary.final_cost, reprojections.solve().summary.final_cost, rtol=1e-6
    )
    assert landmarks().as_pose_graph() is None and landmarks().as_problem() is None


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"solvers": ["dense_qr"]}, r"^solvers: expected only with a reconstruction"),
        ({"backends": ["fused"]}, r"^backends: expected only with a reconstruction"),
        ({"linear_solver_type": "dense_qr"}, r"^linear_solver_type: expected its default"),
        ({"repeat": 0}, r"^repeat: "),
        ({"timeout": 0}, r"^timeout: "),
    ],
)
def test_wrong_arguments_are_one_line(given, words):
    with pytest.raises(bundle.InputError, match=words):
        bundle.compare(landmarks(), **given)


def test_nothing_to_compare_is_one_line():
    with pytest.raises(bundle.InputError, match=r"^graph: expected at least one variable, found 0"):
        bundle.compare(bundle.FactorGraph())
    graph = graphs.loop(2)
    with pytest.raises(bundle.InputError, match=r"^graph: expected a free pose"):
        bundle.compare(graph.replace(fixed=np.ones(graph.num_poses, bool)))
