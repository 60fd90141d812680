"""The co-visibility graph: where images stand, and which edges are worth drawing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import pictures
from bundle.figures.structure_figures import covisibility_graph, within_view
from tests.scenes import make_problem


def shared(problem):
    """Points that each two images share, counted one by one."""
    seen = [set() for _ in range(problem.num_images)]
    for image, point in zip(problem.observation_image, problem.observation_point, strict=True):
        seen[image].add(int(point))
    return {
        (a, b): len(seen[a] & seen[b])
        for a, b in itertools.combinations(range(problem.num_images), 2)
        if seen[a] & seen[b]
    }


def in_a_plane(num_images, seed=3):
    """Images that stand in a plane of space, turned at random."""
    rng = np.random.default_rng(seed)
    problem = make_problem(num_images=num_images, num_points=60, track=3, seed=seed)
    flat = np.column_stack([rng.normal(size=(num_images, 2)) * (5, 2), np.zeros(num_images)])
    centres = Rotation.random(random_state=seed).apply(flat) + np.array([10, -3, 7])
    turned = Rotation.random(num_images, random_state=seed)
    # Quaternions need not be normalised.
    poses = np.hstack([3.0 * turned.as_quat(), -turned.apply(centres)])
    return problem.replace(cam_from_world=poses), flat


def test_edges_and_weights_are_the_points_in_common():
    problem = make_problem(num_images=9, num_points=30, track=3, seed=1)
    graph = covisibility_graph(problem)
    found = {
        (int(a), int(b)): int(count)
        for (a, b), count in zip(graph.edges, graph.weights, strict=True)
    }
    assert found == shared(problem)
    assert graph.num_pairs == len(found)
    assert (np.diff(graph.weights) >= 0).all()


def test_thinning_keeps_the_strongest_of_each_image():
    problem = make_problem(num_images=30, num_points=300, track=4, seed=2)
    every = shared(problem)
    graph = covisibility_graph(problem, max_edges=100)
    assert len(graph.edges) == 100 < graph.num_pairs == len(every)
    kept = {(int(a), int(b)) for a, b in graph.edges}
    for image in range(30):
        best = max(count for pair, count in every.items() if image in pair)
        assert any(image in pair and every[pair] == best for pair in kept)


def test_positions_are_the_centres_as_they_stand_in_their_plane():
    problem, flat = in_a_plane(20)
    positions = covisibility_graph(problem).positions
    np.testing.assert_allclose(
        np.linalg.norm(positions[:, None] - positions, axis=2),
        np.linalg.norm(flat[:, None] - flat, axis=2),
        atol=1e-9,
    )


def test_a_pose_far_outside_is_drawn_at_the_border():
    positions = np.random.default_rng(5).uniform(0, 1, (40, 2))
    positions[7] = (1e9, -1e9)
    seen = within_view(positions)
    assert np.abs(seen).max() < 3
    np.testing.assert_array_equal(np.delete(seen, 7, 0), np.delete(positions, 7, 0))


@pytest.mark.parametrize("num_images", [1, 2, 12])
def test_drawing_says_what_it_shows(num_images, tmp_path):
    problem = make_problem(num_images=num_images, num_points=20)
    made, axes = pictures.figure()
    pictures.draw_covisibility(axes[0, 0], problem, max_edges=5)
    pairs = num_images * (num_images - 1) // 2
    words = axes[0, 0].texts[-1].get_text().replace("\n", " ")
    assert words.startswith(f"{num_images} image") and f", {pairs} pair" in words
    assert ("the strongest 5" in words) == (pairs > 5)
    made.savefig(tmp_path / "graph.png")
