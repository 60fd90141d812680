"""Scenes in blocks, and written as they are made, against the same scene in memory."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bundle
from bundle import InputError, SceneOptions, _core
from bundle.base.components import component_roots
from bundle.model.residuals import reprojection_error
from bundle.synthetic import blocks
from bundle.synthetic.blocks import ErrorTally, SceneInBlocks, SceneTally, write_bal_scene
from tests.scenes import make_problem

ARRAYS = (
    "cam_from_world", "camera_params", "points", "observation_image", "observation_point",
    "observation_xy",
)  # fmt: skip
KINDS = ("street", "orbit", "photo-collection")


def options(**changes):
    settings = {
        "num_images": 10, "num_points": 700, "mean_track_length": 3, "camera_model": "RADIAL",
        "outlier_share": 0.05, "seed": 3,
    }  # fmt: skip
    return SceneOptions(**{**settings, **changes})


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(blocks, "LARGEST_SINGLE", 300)
    monkeypatch.setattr(blocks, "POINTS_PER_BLOCK", 200)
    monkeypatch.setattr(blocks, "_POINTS_PER_IMAGE", 5)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("kind", KINDS)
def test_files_are_those_of_the_scene_in_memory(tmp_path, kind):
    path, truth = tmp_path / "a.txt", tmp_path / "b.txt"
    shares = []
    tally = write_bal_scene(SceneInBlocks(options(scene=kind)), path, truth, shares.append)
    scene = bundle.synthesize(options(scene=kind))
    for written, made in ((path, scene.problem), (truth, scene.ground_truth)):
        bundle.save(made, tmp_path / "whole.txt")
        found, expected = bundle.load(written), bundle.load(tmp_path / "whole.txt")
        for name in ARRAYS:
            assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
        # The first line apart, which keeps room for the number of observations.
        lines, others = written.read_text().splitlines(), (tmp_path / "whole.txt").read_text()
        assert [lines[0].rstrip(), *lines[1:]] == others.splitlines()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.txt", "b.txt", "whole.txt"]
    assert shares == sorted(shares)
    assert len(shares) == 4
    assert shares[-1] == 1
    assert tally.num_observations == scene.problem.num_observations
    assert tally.num_outliers == scene.is_outlier.sum() > 0
    assert_array_equal(tally.observations_per_image, np.bincount(scene.problem.observation_image))
    for name, problem in (("start", scene.problem), ("ground_truth", scene.ground_truth)):
        errors, exact = tally.errors[name], reprojection_error(problem)
        for field in ("rmse", "mean", "max"):
            assert getattr(errors, field) == pytest.approx(getattr(exact, field), rel=1e-12)
        for field in ("num_observations", "num_behind_camera"):
            assert getattr(errors, field) == getattr(exact, field)


@pytest.mark.usefixtures("small_blocks")
def test_scenes_in_blocks_keep_their_promises():
    problem = bundle.synthesize(options(outlier_share=0)).ground_truth
    assert problem.num_points == 700
    assert_array_equal(np.unique(problem.observation_point), np.arange(700))
    assert (np.bincount(problem.observation_point) >= 2).all()
    code = problem.observation_point.astype(np.int64) * 10 + problem.observation_image
    assert (np.diff(code) > 0).all()
    assert np.bincount(problem.observation_image).min() >= 20
    first = np.searchsorted(problem.observation_point, np.arange(700))
    assert len(np.unique(component_roots(problem.observation_image, first, 10))) == 1
    assert reprojection_error(problem).rmse == pytest.approx(0.5 * np.sqrt(2), rel=0.1)
    # Blocks are not copies of each other.
    assert len(np.unique(problem.points, axis=0)) == 700
    errors, _ = bundle.reprojection_errors(problem)
    second = first[700 // 4]
    assert not np.isclose(errors[:50], errors[second : second + 50]).any()


@pytest.mark.usefixtures("small_blocks")
def test_threads_do_not_show(monkeypatch):
    expected = bundle.synthesize(options()).problem
    for threads in (1, 3):
        monkeypatch.setattr(blocks, "_MOST_AT_A_TIME", threads)
        monkeypatch.setattr(_core, "hardware_threads", lambda: 16)
        found = bundle.synthesize(options()).problem
        for name in ARRAYS:
            assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.usefixtures("small_blocks")
def test_nothing_is_left_where_a_block_cannot_be_made(tmp_path):
    paths = [tmp_path / "a.txt", tmp_path / "b.txt"]
    with pytest.raises(InputError, match="mean_track_length"):
        write_bal_scene(SceneInBlocks(options(num_images=40, mean_track_length=40)), *paths)
    paths[0].write_text("before")
    with pytest.raises(InputError, match="BAL"):
        write_bal_scene(SceneInBlocks(options(camera_model="OPENCV")), *paths)

    def interrupt(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_bal_scene(SceneInBlocks(options()), *paths, interrupt)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]
    assert paths[0].read_text() == "before"


def test_quantiles_of_many_errors():
    tally, parts = ErrorTally(), []
    for seed in range(3):
        parts.append(make_problem(num_images=12, num_points=400, seed=seed, perturbation=0.01))
        tally.add(parts[-1])
    parts.append(parts[0].replace(points=50 * parts[0].points))  # half of it behind cameras
    tally.add(parts[-1])
    errors, behind = (
        np.concatenate(arrays)
        for arrays in zip(*map(bundle.reprojection_errors, parts), strict=True)
    )
    errors = errors[~behind & ~np.isnan(errors)]
    found = tally.statistics()
    assert found.num_behind_camera == behind.sum() > 100
    assert found.num_observations == len(errors)
    # To the width of a bin, and the distance of two neighbouring errors.
    assert found.median == pytest.approx(np.quantile(errors, 0.5), rel=2e-3)
    assert found.p95 == pytest.approx(np.quantile(errors, 0.95), rel=1e-2)
    assert found.max == errors.max()


def test_counts_of_parts():
    rng = np.random.default_rng(2)
    tally, lengths = SceneTally(8), []
    image = []
    for longest in (4, 9, 2):
        its = rng.integers(1, longest, 51)
        point = np.repeat(np.arange(51, dtype=np.int32), its)
        image.append(rng.integers(0, 8, len(point)).astype(np.int32))
        tally.add(image[-1], point, image[-1] == 3)
        lengths.append(its)
    whole, images = np.concatenate(lengths), np.bincount(np.concatenate(image), minlength=8)
    for found, values in ((tally.track_length(), whole), (tally.image_size(), images)):
        assert_allclose(
            [found[name] for name in ("min", "mean", "median", "max")],
            [values.min(), values.mean(), np.median(values), values.max()],
        )
    assert tally.num_outliers == images[3]
