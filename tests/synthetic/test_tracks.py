"""Choice of observations and connected components."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bundle import InputError
from bundle.synthetic.observations import components, select_observations
from bundle.synthetic.scene import Pairs


def pairs_of(seen):
    """Pairs of a (num_points, num_images) table of who sees whom."""
    point, image = np.nonzero(np.asarray(seen))
    return Pairs.from_sorted(point.astype(np.int32), image.astype(np.int32), len(seen))


def select(pairs, mean_length, num_images, seed=0):
    rng = np.random.default_rng(seed)
    preference = rng.random(len(pairs))
    weights = rng.standard_exponential(len(pairs.counts))
    return preference, select_observations(pairs, preference, weights, mean_length, num_images)


@pytest.mark.parametrize("seed", range(20))
def test_components_of_random_graphs(seed):
    rng = np.random.default_rng(seed)
    num_images, num_points = 60, 40
    seen = rng.random((num_points, num_images)) < rng.uniform(0.01, 0.05)
    seen[np.arange(num_points), rng.integers(0, num_images, num_points)] = True
    pairs = pairs_of(seen)
    of_image, of_point = components(pairs, num_images)
    edges = (pairs.image, num_images + pairs.point)
    size = num_images + num_points
    graph = coo_array((np.ones(len(pairs)), edges), shape=(size, size))
    expected = connected_components(graph, directed=False)[1]
    for label in np.unique(expected):
        mine = np.flatnonzero(expected == label)
        found = np.concatenate([of_image, of_point])[mine]
        assert_array_equal(found, mine.min())


def test_components_of_a_long_chain_in_random_order():
    order = np.random.default_rng(0).permutation(5000)
    point = np.repeat(np.arange(4999), 2)
    image = np.sort(np.stack([order[:-1], order[1:]], axis=1), axis=1).ravel()
    pairs = Pairs.from_sorted(point.astype(np.int32), image.astype(np.int32), 4999)
    of_image, of_point = components(pairs, 5000)
    assert not of_image.any()
    assert not of_point.any()


def test_preferred_images_are_taken():
    pairs = pairs_of(np.ones((500, 30)))
    preference, chosen = select(pairs, 7.0, 30)
    assert len(chosen) / 500 == pytest.approx(7.0, rel=0.01)
    table = preference.reshape(500, 30)
    for point in range(500):
        its_images = chosen.image[chosen.starts[point] : chosen.starts[point + 1]]
        assert set(its_images) == set(np.argsort(table[point])[: len(its_images)])


def test_poor_images_are_filled_up():
    seen = np.ones((400, 12))
    seen[25:, 3] = 0  # image 3 could see 25 points ...
    seen[11:, 7] = 0  # ... and image 7 only 11
    _, chosen = select(pairs_of(seen), 2.0, 12)
    counts = np.bincount(chosen.image, minlength=12)
    assert counts[3] == 20
    assert counts[7] == 11


def test_parts_are_tied_together():
    seen = np.zeros((600, 20))
    seen[:300, :10] = seen[300:, 10:] = 1
    seen[:15, 10] = 1  # an image of the second half could see points of the first one
    pairs = pairs_of(seen)
    preference = np.random.default_rng(0).random(len(pairs))
    preference[(pairs.point < 300) & (pairs.image == 10)] = 100.0  # and never would by itself
    chosen = select_observations(pairs, preference, np.ones(600), 4.0, 20)
    assert not components(chosen, 20)[0].any()
    assert ((chosen.point < 300) & (chosen.image == 10)).sum() == 10


def test_what_cannot_be_tied_together_is_said():
    seen = np.zeros((600, 20))
    seen[:300, :10] = seen[300:, 10:] = 1
    with pytest.raises(InputError, match="falls into 2 components"):
        select(pairs_of(seen), 4.0, 20)


def test_an_image_with_next_to_nothing_is_said():
    seen = np.ones((300, 6))
    seen[3:, 4] = 0
    with pytest.raises(
        InputError, match=r"num_points: expected about 375 .*found 300, of which image 5 observes 3"
    ):
        select(pairs_of(seen), 3.0, 6)


def test_tracks_longer_than_possible_are_said():
    seen = np.zeros((300, 40))
    for point in range(300):
        seen[point, point % 37 : point % 37 + 4] = 1
    with pytest.raises(InputError, match=r"mean_track_length: expected at most 4\.0, .*found 8"):
        select(pairs_of(seen), 8.0, 40)
