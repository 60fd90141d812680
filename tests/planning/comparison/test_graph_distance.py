"""Distance of two solutions of a pose graph in sigmas, against the covariance."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.planning.comparison.graph_comparison import graph_distance
from tests.campaigns.triage_inputs import chain_of_poses


def moved(result, tangent):
    """The result with each pose moved by X Exp(d), for small d."""
    poses = result.problem.poses.copy()
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    poses[:, 0] += c * tangent[:, 0] - s * tangent[:, 1]
    poses[:, 1] += s * tangent[:, 0] + c * tangent[:, 1]
    poses[:, 2] += tangent[:, 2]
    return dataclasses.replace(result, problem=result.problem.replace(poses=poses))


def test_one_pose_alone_moves_by_its_conditional_sigma():
    best = bundle.solve(chain_of_poses(3, 40, 10))
    lengths = []
    for size in (1e-5, 2e-5):
        tangent = np.zeros((40, 3))
        tangent[20, 0] = size
        lengths.append(graph_distance(moved(best, tangent), best))
    assert lengths[1] == pytest.approx(2 * lengths[0], rel=1e-3)
    assert graph_distance(best, best) == pytest.approx(0.0, abs=1e-9)


def test_it_is_the_rise_of_the_cost():
    """At the minimum the cost rises by d^2 sigma0^2 / 2."""
    best = bundle.solve(chain_of_poses(3, 40, 10))
    rng = np.random.default_rng(0)
    tangent = 1e-4 * rng.standard_normal((40, 3))
    tangent[0] = 0
    other = moved(best, tangent)
    rise = bundle.pose_graph_chi2(other.problem).sum() - best.summary.chi2_final
    freedom = 3 * (best.problem.num_edges - 39)
    sigma0 = np.sqrt(best.summary.chi2_final / freedom)
    assert graph_distance(other, best) == pytest.approx(np.sqrt(rise) / sigma0, rel=0.02)


def test_compared_methods_have_distances():
    graph = chain_of_poses(3, 60, 20)
    found = bundle.compare(graph, backends=["fused"], repeat=1)
    distances = [found.distance_in_sigmas(run) for run in found.runs]
    assert min(distances) < 1e-9 and max(distances) < 1e-3
    space = bundle.compare(graph, backends=["ceres"], repeat=1, max_num_iterations=1)
    assert all(np.isfinite([space.distance_in_sigmas(run) for run in space.runs]))
