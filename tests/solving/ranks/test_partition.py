"""Which process has which points and factors."""

import itertools

import numpy as np
import pytest

import bundle
from bundle.solving.ranks.partition import divide, divide_tracks, factors_of, part_of
from tests.scenes import scene


def covisible_parts(problem, parts):
    """Images that the points of each part see, on average."""
    counts = []
    for points in parts:
        mine = np.isin(problem.observation_point, points)
        counts.append(len(np.unique(problem.observation_image[mine])))
    return np.mean(counts)


@pytest.mark.parametrize("num_parts", [1, 2, 3, 7, 20])
def test_parts_are_balanced_and_complete(num_parts):
    problem = bundle.synthesize(scene="street", num_images=60, num_points=2000, seed=1).problem
    parts = divide(problem, num_parts).parts
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(problem.num_points))
    assert all(np.all(np.diff(part) > 0) for part in parts)
    lengths = np.bincount(problem.observation_point)
    observations = np.array([lengths[part].sum() for part in parts])
    assert np.abs(observations - observations.mean()).max() <= lengths.max()


def test_points_follow_the_images_that_see_them_first():
    problem = bundle.synthesize(scene="street", num_images=60, num_points=2000, seed=1).problem
    first = np.full(problem.num_points, problem.num_images)
    np.minimum.at(first, problem.observation_point, problem.observation_image)
    parts = divide(problem, 5).parts
    for before, after in itertools.pairwise(parts):
        assert first[before].max() <= first[after].min()


def test_parts_are_local():
    problem = bundle.synthesize(scene="street", num_images=200, num_points=4000, seed=1).problem
    parts = divide(problem, 4).parts
    rng = np.random.default_rng(1)
    shuffled = np.array_split(rng.permutation(problem.num_points), 4)
    assert covisible_parts(problem, parts) < 0.5 * covisible_parts(problem, shuffled)


@pytest.mark.parametrize("num_points", [4, 5, 9])
def test_every_part_has_a_point(num_points):
    parts = divide(scene(num_points=num_points), 4).parts
    assert all(len(part) > 0 for part in parts)


@pytest.mark.parametrize("place", [0, 4, 9])
def test_every_part_has_a_point_beside_one_that_all_images_see(place):
    seen = np.ones(10, np.int64)
    seen[place] = 1000
    first = np.arange(10)
    for num_parts in range(1, 11):
        parts = divide_tracks(first, first, seen, num_parts).parts
        assert [len(part) > 0 for part in parts] == [True] * num_parts
        assert np.concatenate(parts).tolist() == list(range(10))


def test_points_without_observations_have_a_home():
    problem = scene(num_points=12)
    kept = np.flatnonzero(problem.observation_point < 3)
    part = problem.replace(
        **{
            name: getattr(problem, name)[kept]
            for name in vars(problem)
            if name.startswith("observation_") and getattr(problem, name) is not None
        }
    )
    parts = divide(part, 5).parts
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(12))
    assert all(len(points) > 0 for points in parts)


def test_a_part_has_the_observations_of_its_points():
    sigma = np.linspace(1, 2, 120)
    problem = scene().replace(observation_sigma=sigma)
    points = np.array([3, 4, 11])
    section = np.arange(problem.num_points, dtype=np.uint16)
    part = part_of(problem, points, section)
    assert np.array_equal(part.point_section, points)
    mine = np.isin(problem.observation_point, points)
    assert np.array_equal(points[part.observation_point], problem.observation_point[mine])
    assert np.array_equal(part.observation_xy, problem.observation_xy[mine])
    assert np.array_equal(part.observation_sigma, sigma[mine])
    assert np.array_equal(part.point_ids, problem.point_ids[points])
    assert part.cam_from_world is problem.cam_from_world
    with pytest.raises(AttributeError):
        part.nothing  # noqa: B018


def test_factors_of_points_go_where_the_points_are():
    places = [("image", 2), ("point", 7), ("camera", 0), ("point", 4)]
    factors = [
        ("position", "factor 0", (0,), "trivial", 1.0, ()),
        ("prior", "factor 1", (1,), "trivial", 1.0, ()),
        ("prior", "factor 2", (3,), "trivial", 1.0, ()),
        ("prior", "factor 3", (2,), "trivial", 1.0, ()),
    ]
    core = (["i2", "p7", "c0", "p4"], factors, places)
    (variables, own, own_places), kept = factors_of(core, np.array([1, 4]))
    assert kept == [0, 2, 3]
    assert variables == ["i2", "c0", "p4"]
    assert own_places == [("image", 2), ("camera", 0), ("point", 1)]
    assert [factor[2] for factor in own] == [(0,), (2,), (1,)]
    assert factors_of(None, np.array([1])) == (None, [])
    assert factors_of((["p7"], [(*factors[1][:2], (0,))], [("point", 7)]), np.array([1])) == (
        None,
        [],
    )
