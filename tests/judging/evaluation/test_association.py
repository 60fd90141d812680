"""Pairs of poses by name, time and order."""

import numpy as np
import pytest

import bundle
from bundle.judging.evaluation.association import associate
from bundle.model.pose_table import PoseTable
from tests.judging.evaluation.worked_example import path

STAMPS = 1403636579763555584 + 50_000_000 * np.arange(6)


def named(*names):
    return PoseTable(path(len(names)).poses, names)


def timed(stamps):
    return PoseTable(path(len(stamps)).poses, (), np.asarray(stamps, np.int64))


@pytest.mark.parametrize(
    ("a", "b", "by", "count"),
    [
        (("x/1.jpg", "x/2.jpg", "x/3.jpg"), ("x/3.jpg", "x/1.jpg", "x/2.jpg"), "name", 3),
        (("x/1.jpg", "x/2.jpg", "x/3.jpg"), ("2.jpg", "1.jpg", "3.jpg", "4.jpg"), "base name", 3),
        (("1.jpg", "2.jpg", "3.jpg"), ("b/1.png", "b/2.png", "b/3.JPG"), "stem", 3),
        (("1.jpg", "2.jpg", "3.jpg"), ("1", "2", "3"), "stem", 3),
        (
            ("a/1.jpg", "b/1.jpg", "2.jpg", "3.jpg", "4.jpg"),
            ("1.png", "2.png", "3.png", "4.png"),
            "stem",
            3,
        ),
    ],
)  # fmt: skip
def test_names_without_folders_and_suffix(a, b, by, count):
    found = associate(named(*a), named(*b))
    assert (found.by, len(found)) == (by, count)
    assert list(found.names) == sorted(found.names)
    assert len(found.only_a) == len(a) - count and len(found.only_b) == len(b) - count
    for row_a, row_b in zip(found.rows_a, found.rows_b, strict=True):
        assert a[row_a].split("/")[-1][0] == b[row_b].split("/")[-1][0]


def test_names_that_no_other_input_has_and_names_that_exist_twice():
    with pytest.raises(bundle.InputError, match=r"at least 3 .*'a1'.*'b1'"):
        associate(named("a1", "a2", "a3"), named("b1", "b2", "b3"))
    with pytest.raises(bundle.InputError, match="found 2 of 3 and 2"):
        associate(named("1", "2", "3"), named("1", "2"))
    with pytest.raises(bundle.InputError, match="a: expected a different name"):
        associate(named("1", "1", "2"), named("1", "2", "3"))


def test_the_nearest_stamps_within_the_tolerance():
    shifted = STAMPS[::-1] + np.array([1, -1, 2, 20, 3, -2]) * 10**6
    found = associate(timed(STAMPS), timed(np.append(shifted, STAMPS[0] + 9 * 10**6)))
    assert found.by == "time" and len(found) == 5
    assert found.rows_a.tolist() == [0, 1, 3, 4, 5] and found.rows_b.tolist() == [5, 4, 2, 1, 0]
    assert associate(timed(STAMPS), timed(shifted), tolerance=0.05).rows_a.tolist() == [*range(6)]
    assert "0.003 s" in found.sentence


def test_names_that_are_stamps():
    for names in (
        [f"cam0/{stamp}.png" for stamp in STAMPS],
        [f"{stamp // 10**9}.{stamp % 10**9:09d}.png" for stamp in STAMPS],
        [f"frame_{stamp}.png" for stamp in STAMPS],
    ):
        found = associate(named(*names), timed(STAMPS + 10**6))
        assert found.by == "time" and found.rows_b.tolist() == [*range(6)]
        assert associate(timed(STAMPS), named(*names)).names == tuple(names)
    with pytest.raises(bundle.InputError, match="time stamps"):
        associate(named("x", "y", "z"), timed(STAMPS))


def test_numbers_of_frames_are_no_seconds():
    names = [f"orbit_{number:04d}.jpg" for number in range(1, 7)]
    for stamps in (np.arange(6), np.arange(1, 7) + 0.5, np.arange(61) / 10, [1, 3, 9]):
        tum = timed(np.round(1e9 * np.asarray(stamps)))
        for pair in ((named(*names), tum), (tum, named(*names))):
            with pytest.raises(bundle.InputError, match=r"the frame 'orbit_0001\.jpg'; a list"):
                associate(*pair)
    # Stamps that count the same frames, all of them or some.
    for frames in ([1, 2, 3, 4, 5, 6], [2, 3, 5], np.arange(30)):
        found = associate(named(*names), timed(10**9 * np.asarray(frames)))
        assert [frames[row] for row in found.rows_b] == [row + 1 for row in found.rows_a]
    # A decimal point or a clock is a time.
    seconds = timed(10**8 * np.arange(6))
    assert len(associate(named(*(f"f{k / 10}.png" for k in range(6))), seconds)) == 6


def test_whole_numbers_are_nanoseconds_from_ten_to_the_fourteenth():
    stamps = 10**14 + 10**6 * np.arange(3)
    found = associate(named(*map(str, stamps)), timed(stamps))
    assert found.rows_b.tolist() == [0, 1, 2]
    with pytest.raises(bundle.InputError, match="time stamps"):
        associate(named(*map(str, stamps - 1)), timed(stamps))


def test_stamps_in_another_unit_are_named():
    seconds = timed(np.arange(6) * 10**9 + 5 * 10**9)
    wrong = timed(np.arange(6) + 5)
    with pytest.raises(bundle.InputError, match="another unit"):
        associate(wrong, seconds)


def test_frames_of_kitti():
    poses = path(10).poses
    kitti = PoseTable(poses, (), None, "kitti")
    found = associate(named("left/000007.png", "left/000002.png", "left/000005.png"), kitti)
    assert found.by == "frame number"
    assert found.rows_a.tolist() == [1, 2, 0] and found.rows_b.tolist() == [2, 5, 7]
    shorter = PoseTable(poses[:4], (), None, "kitti")
    assert len(associate(shorter, kitti)) == 4
    letters = named(*"abcdefghij")
    assert associate(letters, kitti).by == "order"
    with pytest.raises(bundle.InputError, match="poses, as in A"):
        associate(named("a", "b", "c"), kitti)


def test_models_without_names_are_in_order():
    one = PoseTable(path(5).poses, (), None, "bal")
    assert associate(one, one).rows_b.tolist() == [0, 1, 2, 3, 4]
    with pytest.raises(bundle.InputError, match="poses, as in A"):
        associate(one, PoseTable(path(4).poses, (), None, "bal"))
    with pytest.raises(bundle.InputError, match="at least 3"):
        associate(PoseTable(path(2).poses), PoseTable(path(2).poses))


def test_stamps_between_those_of_the_estimate_are_not_missing():
    truth = path(12)
    dense = PoseTable(truth.poses, (), STAMPS[0] + 25_000_000 * np.arange(12))
    estimate = PoseTable(truth.poses[::2], (), STAMPS)
    found = bundle.evaluate(estimate, dense)
    assert found.auc == pytest.approx(found.pairs.auc["colmap"])
    assert "all 6 poses" in found.headline[0]


def test_trajectories_of_the_package_are_inputs():
    poses = path(6).poses
    states = np.hstack([poses, np.zeros((6, 9))])
    found = bundle.evaluate(bundle.Trajectory(STAMPS, states), timed(STAMPS))
    assert found.verdict == "identical" and found.association.by == "time"
    with pytest.raises(bundle.InputError, match="a: expected a Problem"):
        bundle.evaluate(3, timed(STAMPS))
