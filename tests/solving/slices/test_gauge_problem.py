"""Structure in a slice: images that its free points link, and points that are held."""

import numpy as np

from bundle.solving.ranks.partition import divide, part_of
from bundle.solving.slices.slice_process import _of_slice
from bundle.solving.slices.slice_reading import Slice
from tests.scenes import make_problem, with_observations


def slice_with(links):
    """A slice whose point k is in the images links[k]."""
    problem = make_problem(num_images=6, num_points=len(links))
    seen = [image in links[point] for image, point in
            zip(problem.observation_image, problem.observation_point, strict=True)]  # fmt: skip
    problem = with_observations(problem, seen)
    everything = np.arange(problem.num_points)
    part = part_of(problem, everything, divide(problem, 1).section)
    return Slice(problem, part, None, np.ones(6, np.uint8))  # type: ignore[arg-type]


def test_images_are_linked_by_free_points_alone():
    own = slice_with([{0, 5}, {0, 1}, {2, 3, 4}, {3, 5}])
    for held, pieces in (
        ([0], [{0, 1}, {2, 3, 4, 5}]),
        ([0, 1], [{2, 3, 4, 5}]),
        ([3], [{0, 1, 5}, {2, 3, 4}]),
        ([], [{0, 1, 2, 3, 4, 5}]),
    ):
        ids = own.part.point_ids[held]
        links, images, rows, positions, found = _of_slice(own, ids)
        groups = {}
        for image, root in links.tolist():
            groups.setdefault(root, set()).add(image)
        assert sorted(map(sorted, groups.values())) == [sorted(piece) for piece in pieces]
        assert found.tolist() == ids.tolist()
        np.testing.assert_array_equal(positions, own.part.points[held])
        mine = np.isin(own.part.observation_point, held)
        np.testing.assert_array_equal(images, own.part.observation_image[mine])
        np.testing.assert_array_equal(np.array(held, int)[rows], own.part.observation_point[mine])
