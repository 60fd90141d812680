"""Slices of a binary COLMAP model: what the whole reader gives, and its complaints."""

import os
import struct

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.solving.ranks.partition import divide
from bundle.solving.slices.slice_reading import survey
from bundle.solving.slices.sliced_refinement import SlicedRefinement
from tests.io.colmap_models import write_files
from tests.io.test_colmap_checker_binary import (
    BINARY,
    CORRUPT_BINARY,
    LEGAL_BINARY,
    NO_POINT,
    image,
    listed,
    point,
)
from tests.rig_scenes import rig_problem
from tests.scenes import scene
from tests.solving.ranks.thread_crew import ThreadCrew


def read_part(path, found, rank):
    place = np.full(len(found.owner), -1, np.int32)
    mine = np.flatnonzero(found.owner == rank)
    place[mine] = np.arange(len(mine))
    _, fields, failure = _core.read_colmap_part(os.fsencode(path), found.point_ids, place)
    return mine, fields, failure


def check_slices(path, num_parts):
    """Slices are the parts of the whole, and no two of them have a point."""
    problem, found = bundle.load(path), survey(path, num_parts)
    np.testing.assert_array_equal(found.point_ids, problem.point_ids)
    assert found.num_observations == problem.num_observations
    for rank, points in enumerate(divide(problem, num_parts).parts):
        mine, fields, failure = read_part(path, found, rank)
        assert failure is None
        np.testing.assert_array_equal(mine, points)
        seen = np.isin(problem.observation_point, points)
        expected = {
            "points": problem.points[points],
            "observation_point": np.searchsorted(points, problem.observation_point[seen]),
        }
        for name in ("observation_image", "observation_xy", "observation_keypoint"):
            expected[name] = getattr(problem, name)[seen]
        for name in ("camera_params", "image_ids", "image_camera", "image_names", "image_frame"):
            expected[name] = getattr(problem, name)
        for name, values in expected.items():
            np.testing.assert_array_equal(fields[name], values, err_msg=name)


@pytest.mark.parametrize("name", LEGAL_BINARY)
def test_small_models(tmp_path, name):
    check_slices(write_files(tmp_path / "model", LEGAL_BINARY[name]), 1)


def test_ids_far_apart_and_in_no_order(tmp_path):
    far, last = 10**6, 2**63 - 1
    files = {
        "cameras.bin": BINARY["cameras.bin"],
        "images.bin": listed(
            image(9, (1, 1, far), (2, 2, NO_POINT), (3, 3, 5), (4, 4, last)),
            image(7, (5, 5, 5), (6, 6, far), (7, 7, far)),
        ),
        "points3D.bin": listed(
            point(last, (9, 3)),
            point(5, (9, 2), (7, 0), xyz=(1, 2, 3)),
            point(far, (9, 0), (7, 2), (7, 1)),
        ),
    }
    path = write_files(tmp_path / "model", files)
    for num_parts in (1, 2, 3):
        check_slices(path, num_parts)


@pytest.mark.parametrize("problem", [scene(), rig_problem(num_alone=2)])
def test_scenes(tmp_path, problem):
    bundle.save(problem, tmp_path / "model", "colmap")
    check_slices(tmp_path / "model", 3)


EMPTY = ("points3D", listed())  # "found none", as of any model without observations


@pytest.mark.parametrize(
    ("stem", "content"), [case[:2] for case in CORRUPT_BINARY if case[:2] != EMPTY]
)
def test_bad_files_are_named_as_by_one_process(tmp_path, stem, content):
    path = write_files(tmp_path / "model", {**BINARY, f"{stem}.bin": content})
    with pytest.raises(bundle.InputError) as alone:
        bundle.load(path)
    with pytest.raises(bundle.InputError) as sliced:
        SlicedRefinement(ThreadCrew(1), path)
    assert str(sliced.value) == str(alone.value)


def test_of_contradictions_in_two_slices_the_first_of_the_file_is_named(tmp_path):
    """Points 5 and 6 both name a keypoint that is not theirs; each is in a slice of its own."""
    files = {
        **BINARY,
        "images.bin": listed(image(1, (1, 1, 5), (2, 2, 6)), image(2, (3, 3, 5), (4, 4, 6))),
    }
    good = [point(5, (1, 0), (2, 0)), point(6, (1, 1), (2, 1))]
    bad = [point(5, (1, 0), (2, 1)), point(6, (1, 1), (2, 0))]
    for order in (good, [bad[0], good[1]], [good[0], bad[1]], bad, bad[::-1]):
        path = write_files(tmp_path / "model", {**files, "points3D.bin": listed(*order)})
        found = survey(path, 2)
        assert found.owner.tolist() == [0, 1]
        crew = ThreadCrew(2)
        if order is good:
            SlicedRefinement(crew, path)
        else:
            with pytest.raises(bundle.InputError) as alone:
                bundle.load(path)
            with pytest.raises(bundle.InputError) as sliced:
                SlicedRefinement(crew, path)
            assert str(sliced.value) == str(alone.value)
        crew.barrier.abort()


def test_points_that_are_not_those_of_the_survey(tmp_path):
    path = write_files(tmp_path / "model", LEGAL_BINARY["several points, not sorted"])
    place = np.zeros(3, np.int32)
    for ids in ([5, 6], [5, 6, 8]):
        with pytest.raises(bundle.InputError, match="changed"):
            _core.read_colmap_part(os.fsencode(path), np.array(ids, np.int64), place[: len(ids)])
    with pytest.raises(bundle.InputError, match="place"):
        _core.read_colmap_part(os.fsencode(path), np.array([5, 6, 7]), place[:2])


def test_names_longer_than_a_block(tmp_path):
    """The reader looks for the end of a name in steps; blocks are a megabyte."""
    names = [b"a" * size for size in (255, 256, 257, 5000)]
    images = [image(n, (n, n, 5), name=name) for n, name in enumerate(names, 1)]
    track = [(n, 0) for n in range(1, len(names) + 1)]
    padding = image(9, *[(1, 1, NO_POINT)] * 50000, name=b"b" * 300)
    files = {
        "cameras.bin": BINARY["cameras.bin"],
        "images.bin": listed(padding, *images),
        "points3D.bin": listed(point(5, *track)),
    }
    path = write_files(tmp_path / "model", files)
    assert len(struct.pack("<Q", 0) + padding) > 1 << 20
    check_slices(path, 1)
