"""The fast search for visible points against trying every image with every point."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bundle import SceneOptions
from bundle.synthetic.observations import Cells, Visibility
from bundle.synthetic.orbit import Orbit
from bundle.synthetic.photo_collection import PhotoCollection
from bundle.synthetic.scene import draw_intrinsics
from bundle.synthetic.street import ROAD_WIDTH, Street
from tests.scenes import project

KINDS = {"street": Street, "orbit": Orbit, "photo_collection": PhotoCollection}
NO_THINNING = 1e9


def build(kind, count=1500, **changes):
    options = SceneOptions(scene=kind, camera_model="RADIAL", **changes)
    rng = np.random.default_rng(7)
    scene = KINDS[kind](rng, options)
    cameras = draw_intrinsics(rng, scene.images, "RADIAL", shared=options.has_shared_camera)
    return scene, cameras, scene.draw_points(rng, count)


def is_clear(scene, center, positions):
    """(n,) whether no block is at 12 places of the line of sight from a centre to each position."""
    pitch, clearance = scene.blocks
    if pitch == 0:
        return np.ones(len(positions), bool)
    t = ((np.arange(12) + 0.5) / 12)[:, None, None]
    sight = center[:2] + t * (positions[:, :2] - center[:2])
    away = np.abs(sight - pitch * np.round(sight / pitch))
    return ~(away > clearance).all(axis=2).any(axis=0)


def sees(scene, cameras, points, image):
    """(n,) whether an image sees each point, condition by condition."""
    images = scene.images
    ray = points.positions - images.centers[image]
    distance = np.linalg.norm(ray, axis=1)
    in_camera = ray @ images.rotations[image].T
    with np.errstate(all="ignore"):
        xy = project("RADIAL", cameras.of_image(image), in_camera)
    # Rays far outside the field of view may be folded into the image by distortion.
    half_diagonal = 0.5 * np.linalg.norm(images.sizes[image]) / cameras.of_image(image)[0]
    with np.errstate(all="ignore"):
        off_axis = np.linalg.norm(in_camera[:, :2], axis=1) / in_camera[:, 2]
    cosine = -(points.normals * ray).sum(axis=1) / distance
    all_round = (points.normals == 0).all(axis=1)
    return (
        (
            np.linalg.norm(points.keys - images.ball_centers[image], axis=1)
            <= images.ball_radii[image]
        )
        & (distance <= points.reach)
        & (all_round | (cosine >= scene.min_cosine))
        & (in_camera[:, 2] > 0)
        & (off_axis < 1.3 * half_diagonal)
        & ((xy >= 0) & (xy <= images.sizes[image])).all(axis=1)
        & is_clear(scene, images.centers[image], points.positions)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_same_as_brute_force(kind):
    scene, cameras, points = build(kind, num_images=25)
    lengths = np.full(len(points), NO_THINNING)
    pairs = Visibility(scene, cameras).pairs(np.random.default_rng(0), points, lengths)
    expected = np.stack([sees(scene, cameras, points, image) for image in range(25)], axis=1)
    assert 2 * len(points) < expected.sum() < 0.9 * expected.size
    found = np.zeros_like(expected)
    found[pairs.point, pairs.image] = True
    assert_array_equal(found, expected)
    assert len(pairs) == found.sum()
    assert_array_equal(pairs.counts, expected.sum(axis=1))
    assert_array_equal(pairs.ranks, (np.cumsum(expected, axis=1) - 1)[expected])


def test_thinning_takes_a_subset_and_leaves_enough():
    scene, cameras, points = build("photo_collection", 20000, num_images=200)
    everything, thinned = (
        Visibility(scene, cameras).pairs(
            np.random.default_rng(0), points, np.full(len(points), length)
        )
        for length in (NO_THINNING, 3.0)
    )
    codes = [set((pairs.point.astype(int) * 200 + pairs.image).tolist()) for pairs in
             (everything, thinned)]  # fmt: skip
    assert codes[1] <= codes[0]
    assert len(codes[1]) < 0.7 * len(codes[0])
    assert thinned.counts.mean() > 3.0


def test_an_image_that_would_keep_few_keeps_all():
    scene, cameras, points = build("street")
    seen = Visibility(scene, cameras)
    all_of_them, few = (
        seen.pairs(np.random.default_rng(0), points, np.full(len(points), length))
        for length in (NO_THINNING, 1e-9)
    )
    assert_array_equal(few.point, all_of_them.point)
    assert_array_equal(few.image, all_of_them.image)


def test_blocks_hide_what_is_behind_them():
    street, _, _ = build("street", num_images=400)
    pitch, side = street.pitch, 0.5 * ROAD_WIDTH
    center = np.array([0.5 * pitch, 0.0, 1.9])
    positions = np.array(
        [
            [0.5 * pitch + 10.0, side, 2.0],  # a facade of the same road
            [1.0 * pitch, 20.0, 2.0],  # round the corner
            [0.5 * pitch, pitch, 2.0],  # the parallel road
            [2.0 * pitch, 2.0, 2.0],  # down the same road
        ]
    )
    assert_array_equal(is_clear(street, center, positions), [True, False, False, True])


def test_street_points_are_on_surfaces():
    street, _, points = build("street", num_images=400)
    offset = np.abs(
        points.positions[:, :2] - street.pitch * np.round(points.positions[:, :2] / street.pitch)
    )
    is_facade = np.abs(points.normals[:, :2]).any(axis=1)
    assert 0.4 < is_facade.mean() < 0.9
    depth = offset.min(axis=1)[is_facade] - 0.5 * ROAD_WIDTH
    assert depth.min() >= -1e-9
    assert np.quantile(depth, 0.99) < 1.0
    is_ground = points.normals[:, 2] == 1
    assert np.abs(points.positions[is_ground, 2]).max() < 0.2
    assert (offset.min(axis=1)[~is_facade] <= 0.5 * ROAD_WIDTH).all()


def test_cells_hold_all_points():
    rng = np.random.default_rng(3)
    keys = rng.uniform(-5, 20, (4000, 3)) * [1, 0.3, 2]
    cells = Cells(keys, 1.7)
    assert_array_equal(np.sort(cells.order), np.arange(4000))
    cell = np.repeat(np.arange(len(cells)), np.diff(cells.starts))
    away = np.abs(keys[cells.order] - cells.centers[cell])
    assert (away <= 0.5 * 1.7 + 1e-12).all()
    assert len(np.unique(cells.centers, axis=0)) == len(cells)
    assert cells.half_diagonal == pytest.approx(np.linalg.norm([0.85, 0.85, 0.85]))


def test_threads_do_not_show():
    """Random numbers are drawn image by image, in order."""
    scene, cameras, points = build("street")
    lengths = np.full(len(points), 1.0)  # so that pairs are thinned

    def pairs(threads=0):
        return Visibility(scene, cameras).pairs(np.random.default_rng(5), points, lengths, threads)

    expected = pairs()
    assert len(expected) < len(
        Visibility(scene, cameras).pairs(np.random.default_rng(5), points, NO_THINNING * lengths)
    )
    for threads in (1, 4):
        found = pairs(threads)
        assert_array_equal(found.point, expected.point)
        assert_array_equal(found.image, expected.image)
