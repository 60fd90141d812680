"""Folds of observations: groups that are held out of a fit together.

The fold of an observation depends on the seed, its image id and its point id alone. It depends on
no order of rows, and any program can repeat it: all numbers are whole numbers modulo 2^64.

    mix(z):               z += 0x9e3779b97f4a7c15
                          z = (z xor z >> 30) 0xbf58476d1ce4e5b9
                          z = (z xor z >> 27) 0x94d049bb133111eb
                          mix = z xor z >> 31
    key(image, point)   = mix(mix(mix(seed) xor image id) xor point id)
    fold of rank r      = (mix(mix(seed) xor point id) + r) mod k

mix is the output function of splitmix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom
number generators"). The images of a point are sorted by their keys, and r is the rank of an image.
So the folds of a point's images are as equal in number as possible, at most ceil(n / k) of n. A
point takes part only if ``keep`` images remain whatever fold is held out: n - ceil(n / k) >= keep.
Several observations of a point in one image share their fold, because one predicts the other.

mix is a bijection of the numbers below 2^64. Images of one point therefore have different keys, and
sorting by the key needs no second criterion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.option_fields import number
from bundle.model.problem import Problem

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)

_Numbers = NDArray[np.uint64]


def mix(values: _Numbers) -> _Numbers:
    """Return splitmix64's output for each state; the state is advanced first."""
    with np.errstate(over="ignore"):
        z = np.asarray(values, np.uint64) + _GOLDEN
        z = (z ^ (z >> np.uint64(30))) * _FIRST
        z = (z ^ (z >> np.uint64(27))) * _SECOND
    mixed: _Numbers = z ^ (z >> np.uint64(31))
    return mixed


def keys(seed: int, image_ids: NDArray[np.int64], point_ids: NDArray[np.int64]) -> _Numbers:
    """Return the key of each pair of an image id and a point id."""
    return mix(mix(_mixed(seed) ^ image_ids.astype(np.uint64)) ^ point_ids.astype(np.uint64))


def folds_of(
    problem: Problem, num_folds: int = 5, seed: int = 0, keep: int = 2
) -> NDArray[np.int16]:
    """Return the fold of each observation, 0 to num_folds - 1; -1: it is never held out.

    Args:
        num_folds: number of folds, from 2 to 1000.
        seed: whole number; another seed gives other folds.
        keep: smallest number of images of a point that remain when a fold is held out.
    """
    count = int(number("num_folds", num_folds, minimum=2, maximum=1000, whole=True))
    seed = int(number("seed", seed, minimum=0, whole=True))
    keep = int(number("keep", keep, minimum=1, whole=True))
    if not problem.num_observations:
        return np.zeros(0, np.int16)
    point = problem.observation_point
    pair = keys(seed, problem.image_ids[problem.observation_image], problem.point_ids[point])
    order = _by_point(point, pair, problem.num_points)
    point, pair = point[order], pair[order]
    begins = np.ones(len(point), bool)  # first observation of a point
    begins[1:] = point[1:] != point[:-1]
    is_new = begins.copy()  # first observation of a point in an image
    is_new[1:] |= pair[1:] != pair[:-1]
    images = np.cumsum(is_new, dtype=np.int64)
    first = images[begins]
    num_images = np.diff(first, append=images[-1] + 1)
    track = np.cumsum(begins, dtype=np.int64) - 1  # number of the point's track
    rank = images - first[track]
    base = mix(_mixed(seed) ^ problem.point_ids[point[begins]].astype(np.uint64))
    with np.errstate(over="ignore"):
        fold = (base[track] + rank.astype(np.uint64)) % np.uint64(count)
    takes_part = num_images - -(-num_images // count) >= keep
    folds = np.empty(len(point), np.int16)
    folds[order] = np.where(takes_part[track], fold.astype(np.int16), np.int16(-1))
    return folds


def _mixed(seed: int) -> _Numbers:
    return mix(np.array(seed, np.uint64))


def _by_point(point: NDArray[np.int32], pair: _Numbers, num_points: int) -> NDArray[np.int64]:
    """Return the order of observations by point, then by key.

    One sort of the point with the leading bits of the key is faster than two sorts. Equal leading
    bits of different keys are rare; then all observations are sorted by both.
    """
    bits = np.uint64(max(1, int(num_points - 1).bit_length()))
    joined = (point.astype(np.uint64) << (np.uint64(64) - bits)) | (pair >> bits)
    order = np.argsort(joined)
    joined, sorted_pair = joined[order], pair[order]
    if ((joined[1:] == joined[:-1]) & (sorted_pair[1:] != sorted_pair[:-1])).any():
        order = np.lexsort((pair, point))
    return order


def are_repeated(problem: Problem, folds: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Return a mask of observations whose measurement occurs in another fold, too.

    Duplicate points (one feature, triangulated as two points) have the same measurements. A fit
    without the fold of one duplicate has seen the same noise at the other, and predicts it.
    """
    number = measurement_numbers(problem.observation_image, problem.observation_xy)
    count = int(number.max(initial=-1)) + 1
    lowest, highest = np.full(count, np.iinfo(folds.dtype).max), np.full(count, -1)
    np.minimum.at(lowest, number, folds)
    np.maximum.at(highest, number, folds)
    repeated: NDArray[np.bool_] = (lowest != highest)[number]
    return repeated


def measurement_numbers(image: NDArray[np.int32], xy: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a number for each distinct pair of image and pixel, from 0."""
    order = np.lexsort((xy[:, 1], xy[:, 0], image))
    is_new = np.zeros(len(order), bool)
    is_new[1:] = image[order[1:]] != image[order[:-1]]
    is_new[1:] |= (xy[order[1:]] != xy[order[:-1]]).any(axis=1)
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(is_new)
    return number
