"""Finding about points that exist twice, at the limits of its test."""

from types import SimpleNamespace

import numpy as np
import pytest

from bundle.judging.findings import duplicates
from bundle.judging.findings.duplicates import FEWEST_PAIRS, SHARE, duplicate_points
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from tests.scenes import make_problem


def found(num_points, num_twins, shift=0.0):
    """Return the finding for a scene in which the first points exist twice, pixels apart."""
    problem = make_problem(num_images=6, num_points=num_points)
    twins = np.flatnonzero(problem.observation_point < num_twins)

    def doubled(name, shift=0):
        values = getattr(problem, name)
        return np.concatenate([values, values[twins] + shift])

    xy = doubled("observation_xy")
    xy[problem.num_observations :] += shift
    problem = problem.replace(
        points=np.concatenate([problem.points, problem.points[:num_twins]]),
        point_ids=np.arange(1, num_points + num_twins + 1),
        observation_image=doubled("observation_image"),
        observation_point=doubled("observation_point", num_points),
        observation_xy=xy,
        observation_keypoint=np.full(problem.num_observations + len(twins), -1, np.int32),
        source=None,
    )
    return duplicate_points(Measured(whole=problem, command=NextCommand("INPUT", "OUTPUT", ())))


@pytest.mark.parametrize(
    ("num_points", "num_twins", "is_found"),
    [
        (30, FEWEST_PAIRS - 1, False),  # 8 of 34 points: too few to matter
        (30, FEWEST_PAIRS, True),
        (400, 18, False),  # 8.6 %
        (400, 30, True),
    ],
)
def test_pairs_must_be_several_and_a_share_of_the_points(num_points, num_twins, is_found):
    finding = found(num_points, num_twins)
    assert (finding is not None) == is_found
    if finding is not None:
        assert finding.evidence["num_pairs"] == num_twins
        share = 2 * num_twins / (num_points + num_twins)
        assert finding.evidence["share"] == pytest.approx(share) and share >= SHARE


def test_pixels_are_compared_to_a_tenth():
    assert found(100, 30, 0.001).evidence["num_pairs"] > 20
    assert found(100, 30, 0.3) is None


def pairs_of(*observations):
    """Return the pairs among observations (image, point) at one pixel."""
    image, point = np.array(observations).T
    problem = SimpleNamespace(
        observation_image=image, observation_point=point, num_points=9,
        observation_xy=np.ones((len(image), 2)),
    )  # fmt: skip
    return duplicates._pairs(problem).tolist()


def test_pairs_are_those_of_two_images():
    assert pairs_of((0, 1), (0, 4), (1, 4), (1, 1)) == [[1, 4]]
    # Repeats in one image are one coincidence.
    assert pairs_of((0, 1), (0, 4), (0, 1), (0, 4)) == []
    assert pairs_of((0, 1), (1, 4), (2, 1), (3, 4)) == []
    # Five points: each pair of them.
    five = [(image, point) for image in (0, 1) for point in (0, 2, 3, 5, 7)]
    assert len(pairs_of(*five)) == 10
    # Six: each with the four that follow it.
    six = [(image, point) for image in (0, 1) for point in (0, 2, 3, 5, 7, 8)]
    assert len(pairs_of(*six)) == 14 and [0, 8] not in pairs_of(*six)


def test_two_points_at_one_pixel_of_one_image_are_no_duplicates():
    """Two features may touch in one image by chance; in a second image they do not."""
    problem = make_problem(num_images=6, num_points=60)
    order = np.lexsort((problem.observation_point, problem.observation_image))
    for num_images, is_found in ((1, False), (2, True)):
        xy = problem.observation_xy.copy()
        for image in range(num_images):
            rows = order[problem.observation_image[order] == image]
            points = problem.observation_point[rows]
            row = dict(zip(points.tolist(), rows.tolist(), strict=True))
            for even in range(0, 60, 2):
                if even in row and even + 1 in row:
                    xy[row[even + 1]] = xy[row[even]]
        measured = Measured(whole=problem.replace(observation_xy=xy), command=NextCommand())
        assert (duplicate_points(measured) is not None) == is_found
