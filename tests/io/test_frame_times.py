"""Times and neighbours of images: exact gaps, several videos, columns of the file."""

import numpy as np
import pytest

import bundle
from bundle.io.rolling_shutter_file import LONGEST_GAP, neighbours_in_time, read_frame_times
from tests import scenes

ONE = np.zeros(4, np.int32)


@pytest.mark.parametrize(("gap", "joined"), [(4.0, True), (4.0 + 1e-9, False)])
def test_the_longest_gap_is_four_median_gaps(gap, joined):
    """Gaps 1, 1 and g: their median is 1."""
    assert LONGEST_GAP == 4.0
    found = neighbours_in_time(np.array([0.0, 1.0, 2.0, 2.0 + gap]), ONE)
    assert found[:2].tolist() == [[0, 1], [0, 2]]
    assert found[2:].tolist() == ([[1, 3], [2, 3]] if joined else [[1, 2], [-1, -1]])


def test_the_median_is_that_of_the_gaps_of_the_same_camera():
    """Gaps of 10 are usual in camera 1, which camera 0 with gaps of 1 does not change."""
    frames = np.array([0.0, 1, 2, 3, 10, 20, 30, 70])
    camera = np.array([0, 0, 0, 0, 1, 1, 1, 1], np.int32)
    found = neighbours_in_time(frames, camera)
    assert found[:4].tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]
    assert found[4:].tolist() == [[4, 5], [4, 6], [5, 7], [6, 7]]
    frames[-1] = 71.0
    assert neighbours_in_time(frames, camera)[6:].tolist() == [[5, 6], [-1, -1]]


def test_images_of_one_time_are_not_joined_and_do_not_count():
    """Two images at frame 1: the gap 0 is none, and the median is that of the others."""
    found = neighbours_in_time(np.array([0.0, 1, 1, 6]), ONE)
    assert found.tolist() == [[0, 1], [0, 1], [2, 3], [2, 3]]
    assert (neighbours_in_time(np.ones(4), ONE) == -1).all()
    assert (neighbours_in_time(np.full(4, np.nan), ONE) == -1).all()


def test_the_order_of_the_images_does_not_matter():
    frames = np.array([30.0, 0.0, 20.0, 10.0])
    assert neighbours_in_time(frames, ONE).tolist() == [[2, 0], [1, 3], [3, 0], [1, 2]]


@pytest.fixture
def problem():
    return scenes.make_problem(num_images=4, num_points=10, shared=True)


def read(problem, tmp_path, text, **how):
    (tmp_path / "times.csv").write_text(text)
    return read_frame_times(tmp_path / "times.csv", problem, **how)


def test_given_neighbours(problem, tmp_path):
    """Neighbours of another video, without a time, alone or equal are none."""
    a, b, c, d = problem.image_ids.tolist()
    text = "image_id,frame,neighbour_a,neighbour_b\n"
    text += f"{a},0,,{b}\n{b},5,{a},{c}\n{c},10,{b},{d}\n99,11,{a},{b}\n"
    frames, neighbours = read(problem, tmp_path, text)
    np.testing.assert_array_equal(frames, [0, 5, 10, np.nan])
    # a: its own start and b; c: d has no time; d is not in the file.
    assert neighbours.tolist() == [[0, 1], [0, 2], [-1, -1], [-1, -1]]
    text = f"image_id,frame,neighbour_a,neighbour_b\n{a},0,{a},{a}\n{b},1,{a},\n"
    assert read(problem, tmp_path, text)[1].tolist() == [[-1, -1], [0, 1], [-1, -1], [-1, -1]]


def test_one_column_of_neighbours_is_not_used(problem, tmp_path):
    a, b, c, _ = problem.image_ids.tolist()
    text = f"image_id,frame,neighbour_a\n{a},0,{c}\n{b},5,{c}\n{c},10,{a}\n"
    assert read(problem, tmp_path, text)[1][:3].tolist() == [[0, 1], [0, 2], [1, 2]]


def test_times_in_seconds_are_multiplied_by_the_rate(problem, tmp_path):
    a, b, _, _ = problem.image_ids.tolist()
    frames, _ = read(problem, tmp_path, f" image_id ,time_s\n{a},2\n{b},2.5\n", frame_rate=30)
    assert frames[:2].tolist() == [60, 75]
    frames, _ = read(problem, tmp_path, f"image_id,frame\n{a},2\n{b},2.5\n", frame_rate=30)
    assert frames[:2].tolist() == [2, 2.5]
    for rate in (0, -1, np.nan):
        with pytest.raises(bundle.InputError, match="--frame-rate"):
            read(problem, tmp_path, f"image_id,time_s\n{a},2\n", frame_rate=rate)
    with pytest.raises(bundle.InputError, match="found none of them"):
        read(problem, tmp_path, "image_id,frame\n77,2\n")


def test_rows_may_be_short(problem, tmp_path):
    """Cells that a row does not have are empty: no neighbour, no image."""
    a, b, c, _ = problem.image_ids.tolist()
    rows = f"{a},0\n{b},5,{a}\n{c},10,{b},{a}\n"
    _, found = read(problem, tmp_path, f"image_id,frame,neighbour_a,neighbour_b\n{rows}")
    assert found.tolist() == [[-1, -1], [0, 1], [1, 0], [-1, -1]]
    frames, _ = read(problem, tmp_path, f"frame,image_id\n1\n2,{b}\n")
    np.testing.assert_array_equal(frames, [np.nan, 2, np.nan, np.nan])
    with pytest.raises(bundle.InputError, match=r"times.csv:2: frame: expected a number"):
        read(problem, tmp_path, f"image_id,frame\n{a}\n")
