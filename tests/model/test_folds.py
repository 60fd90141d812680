"""Folds of observations, against the rule in plain Python integers."""

import hashlib
import os
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.model import folds as module
from bundle.model.folds import are_repeated, folds_of, keys, measurement_numbers, mix
from tests.scenes import make_problem, with_observations

DATA = Path(os.environ.get("BUNDLE_DATA", "../shared/data"))
ALL = (1 << 64) - 1


def mixed(z):
    z = (z + 0x9E3779B97F4A7C15) & ALL
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & ALL
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & ALL
    return z ^ (z >> 31)


def by_loops(problem, seed, count, keep):
    rows = defaultdict(lambda: defaultdict(list))
    images = problem.image_ids[problem.observation_image].tolist()
    points = problem.point_ids[problem.observation_point].tolist()
    for row, (image, point) in enumerate(zip(images, points, strict=True)):
        rows[point][image].append(row)
    out = np.full(len(images), -1)
    for point, seen in rows.items():
        if len(seen) - -(-len(seen) // count) < keep:
            continue
        base = mixed(mixed(seed) ^ point)
        order = sorted((mixed(mixed(mixed(seed) ^ image) ^ point), image) for image in seen)
        for rank, (_, image) in enumerate(order):
            out[seen[image]] = ((base + rank) & ALL) % count
    return out


def tracks(seed=0, **changes):
    """Return points in one to six images, ids with gaps, repeats of an image, rows in disorder."""
    rng = np.random.default_rng(seed)
    problem = make_problem(num_images=6, num_points=80, **changes)
    rows = rng.choice(problem.num_observations, 300)
    rows = rng.permutation(np.concatenate([np.unique(rows), rows[:25]]))
    problem = with_observations(problem, rows)
    return problem.replace(
        image_ids=[9, 2, 2**31, 5, 100, 7],
        point_ids=rng.choice(2**62, problem.num_points, replace=False),
    )


def test_numbers_of_the_rule():
    assert [int(mix(np.uint64(n))) for n in (0, 1)] == [0xE220A8397B1DCDAF, 0x910A2DEC89025CC1]
    pairs = keys(0, np.array([1]), np.array([1])), keys(1, np.array([2]), np.array([3]))
    assert [int(key[0]) for key in pairs] == [0x465391958FC61F13, 0xD0734750FDE362B3]


@pytest.mark.parametrize(
    ("name", "sizes", "digest"),
    [
        ("bartoszek", [282, 1124, 1100, 1108, 1141, 1176], "8b9bc5b74e6c616f"),
        ("crane_mast", [1721, 865, 856, 838, 874, 883], "1ba327bcaa166bbb"),
    ],
)
def test_folds_of_real_models(name, sizes, digest):
    path = DATA / "colmap" / name
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    problem = bundle.load(path)
    found = folds_of(problem)
    assert np.bincount(found + 1).tolist() == sizes
    point_ids = problem.point_ids[problem.observation_point]
    order = np.lexsort((point_ids, problem.image_ids[problem.observation_image]))
    assert hashlib.sha256(found[order].astype(np.int8).tobytes()).hexdigest().startswith(digest)


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1])
@pytest.mark.parametrize(("count", "keep"), [(5, 2), (2, 1), (3, 3), (17, 2), (1000, 1)])
def test_folds_equal_the_rule_in_plain_integers(seed, count, keep):
    problem = tracks()
    expected = by_loops(problem, seed, count, keep)
    assert len(set(expected.tolist())) > 2
    np.testing.assert_array_equal(folds_of(problem, count, seed, keep), expected)


def test_keys_that_agree_in_their_leading_bits(monkeypatch):
    """Sort by the whole key where the leading bits do not decide."""
    problem = tracks()
    expected = folds_of(problem)
    few = module.keys

    def alike(*given):  # order as before, in the last bits alone
        pairs = few(*given)
        return np.argsort(np.argsort(pairs, kind="stable"), kind="stable").astype(np.uint64)

    plain = with_observations(problem, first_of_pairs(problem))
    expected = folds_of(plain)
    monkeypatch.setattr(module, "keys", alike)
    np.testing.assert_array_equal(folds_of(plain), expected)


def first_of_pairs(problem):
    pairs = np.stack([problem.observation_image, problem.observation_point])
    return np.sort(np.unique(pairs, axis=1, return_index=True)[1])


def test_order_of_rows_has_no_influence():
    problem, rng = tracks(), np.random.default_rng(5)
    found = folds_of(problem)
    rows = rng.permutation(problem.num_observations)
    np.testing.assert_array_equal(folds_of(with_observations(problem, rows)), found[rows])
    images, points = rng.permutation(problem.num_images), rng.permutation(problem.num_points)
    moved = problem.replace(
        image_ids=problem.image_ids[images],
        point_ids=problem.point_ids[points],
        points=problem.points[points],
        observation_image=np.argsort(images)[problem.observation_image],
        observation_point=np.argsort(points)[problem.observation_point],
    )
    np.testing.assert_array_equal(folds_of(moved), found)


def test_a_point_keeps_images_and_repeats_share_a_fold():
    problem = tracks()
    image, point = problem.observation_image, problem.observation_point
    for keep in (1, 2, 3):
        found = folds_of(problem, 3, keep=keep)
        for row in range(problem.num_points):
            of_point = point == row
            used = found[of_point]
            if (used < 0).any():
                count = len(set(image[of_point].tolist()))
                assert (used < 0).all()
                assert count - -(-count // 3) < keep
            for fold in set(used.tolist()) - {-1}:
                assert len(set(image[of_point][used != fold].tolist())) >= keep
            for each in set(image[of_point].tolist()):
                assert len(set(used[image[of_point] == each].tolist())) == 1


def test_numbers_out_of_range_and_no_observations():
    problem = tracks()
    for wrong in ({"num_folds": 1}, {"seed": -1}, {"keep": 0}, {"num_folds": 2.5}):
        with pytest.raises(bundle.InputError, match=f"^{next(iter(wrong))}: expected"):
            folds_of(problem, **wrong)
    assert folds_of(with_observations(problem, slice(0))).shape == (0,)


def test_measurements_that_another_fold_repeats():
    problem = make_problem(num_images=4, num_points=30)
    rng = np.random.default_rng(0)
    xy = problem.observation_xy.round(-2)  # coarse: many equal pixels
    folds = rng.integers(-1, 3, len(xy)).astype(np.int16)
    seen, measurements = defaultdict(set), []
    for image, pixel, fold in zip(
        problem.observation_image.tolist(), xy.tolist(), folds, strict=True
    ):
        measurements.append((image, *pixel))
        seen[measurements[-1]].add(int(fold))
    number = measurement_numbers(problem.observation_image, xy)
    assert (
        len(set(zip(number.tolist(), measurements, strict=True))) == len(seen) == number.max() + 1
    )
    repeated = are_repeated(problem.replace(observation_xy=xy), folds)
    assert repeated.tolist() == [len(seen[one]) > 1 for one in measurements]
    assert 0 < repeated.sum() < len(repeated)
    none = with_observations(problem, np.zeros(0, int))
    assert len(are_repeated(none, folds[:0])) == 0
