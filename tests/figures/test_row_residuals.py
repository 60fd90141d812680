"""Residuals by row: planted motions, noise alone, and what cannot be drawn."""

import numpy as np
import pytest

import bundle
from bundle.figures.marks import GREY, Line
from bundle.figures.residual_field import NUM_BANDS, row_figure, row_residuals, rows_of_sets
from bundle.model.residuals import Residuals
from bundle.synthetic.video_scene import film

IMAGES, PER_IMAGE = 40, 600


def scene(seed=0, **changes):
    rng = np.random.default_rng(seed)
    count = IMAGES * PER_IMAGE
    problem = bundle.Problem(
        cam_from_world=np.tile([0.0, 0, 0, 1, 0, 0, 2], (IMAGES, 1)),
        camera_models=("SIMPLE_PINHOLE",),
        camera_params=np.array([[500.0, 320, 240]]),
        camera_sizes=[[640, 480]],
        points=np.zeros((PER_IMAGE, 3)),
        observation_image=np.repeat(np.arange(IMAGES), PER_IMAGE),
        observation_point=np.tile(np.arange(PER_IMAGE), IMAGES),
        observation_xy=rng.uniform([0, 0], [640, 480], (count, 2)),
    )
    return problem.replace(**changes), rng.normal(0, 0.5, (count, 2)), rng


def rows(problem, noise, motion=0.0):
    """Return the profile of noise and of a motion (IMAGES, 2) per height, by row."""
    share = problem.observation_xy[:, 1:] / 480 - 0.5
    moved = np.zeros((IMAGES, 2)) + motion
    xy = noise + moved[problem.observation_image] * share
    return row_residuals(problem, Residuals(xy, np.ones(len(xy), bool)))


def test_noise_alone_has_the_size_that_is_expected():
    problem, noise, _ = scene()
    found = rows(problem, noise)
    assert (found.num_images == IMAGES).all()
    np.testing.assert_allclose(found.size, found.noise[:, None] * [1, 1], rtol=0.45)
    assert np.sqrt((found.size**2).mean()) == pytest.approx(
        np.sqrt((found.noise**2).mean()), rel=0.03
    )


def test_a_motion_grows_towards_the_first_and_the_last_row():
    problem, noise, rng = scene()
    motion = rng.normal(0, [1.0, 0.5], (IMAGES, 2))
    found = rows(problem, noise, motion)
    expected = np.abs(found.row - 0.5)[:, None] * np.sqrt((motion**2).mean(axis=0))
    np.testing.assert_allclose(found.size, np.hypot(expected, found.noise[:, None]), rtol=0.3)


def test_outliers_and_uncounted_observations_are_left_out():
    problem, noise, _ = scene()
    expected = rows(problem, noise)
    spoiled = noise.copy()
    spoiled[::50] = 1e4
    counted = np.ones(len(noise), bool)
    counted[::25] = False
    spoiled[::25] = np.nan
    found = row_residuals(problem, Residuals(spoiled, counted))
    np.testing.assert_allclose(found.noise, expected.noise, rtol=0.1)
    assert np.isfinite(found.size).all() and found.size.max() < 1


def test_columns_of_cameras_that_read_columns():
    made = film(
        bundle.SceneOptions(scene="orbit", num_images=6, num_points=200, rolling_shutter=0.9),
        direction="columns",
    )
    problem = made.ground_truth
    found = row_residuals(problem, bundle.figures.residuals(problem))
    assert found.is_by_column
    assert "column" in row_figure({"now": found}).x.label


def test_few_images_and_unknown_sizes():
    problem, noise, _ = scene()
    sizes = np.zeros((1, 2), int)
    everything = Residuals(noise, np.ones(len(noise), bool))
    assert row_residuals(problem.replace(camera_sizes=sizes), everything) is None
    assert row_residuals(problem, Residuals(noise, np.zeros(len(noise), bool))) is None
    assert rows_of_sets({"now": (problem.replace(camera_sizes=sizes), everything)}) == {}
    two = problem.select(images=[0, 1]).problem
    few = row_residuals(two, Residuals(noise[: 2 * PER_IMAGE], np.ones(2 * PER_IMAGE, bool)))
    assert np.isnan(few.size).all()
    assert np.isfinite(row_figure({"now": few}).y.high)


def test_before_is_dashed_and_noise_is_grey():
    problem, noise, _ = scene()
    found = rows(problem, noise)
    lines = [m for m in row_figure({"before": found, "after": found}).marks if isinstance(m, Line)]
    assert [line.dash for line in lines] == [1, 1, 0, 0, 2]
    assert lines[-1].colour == GREY
    assert len(lines[0].x) == NUM_BANDS
