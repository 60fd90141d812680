"""Losses of a problem saved as a BAL file, and problems that cannot be saved so."""

from pathlib import Path

import numpy as np
import pytest

import bundle
from tests.io.bal_files import bal_text, colmap_residuals, load_bytes, make_bal, parse_bal


def with_cameras(
    problem: bundle.Problem, model: str, params: list[list[float]], **changes: object
) -> bundle.Problem:
    return problem.replace(
        camera_models=(model,) * len(params),
        camera_params=np.array(params),
        camera_ids=np.arange(len(params)),
        **{"camera_sizes": np.zeros((len(params), 2), np.int64), **changes},
    )


@pytest.mark.parametrize(
    ("model", "params", "expected"),
    [
        ("SIMPLE_PINHOLE", [500, 0, 0], [500, 0, 0]),
        ("PINHOLE", [500, 500, 0, 0], [500, 0, 0]),
        ("SIMPLE_RADIAL", [500, 0, 0, 0.1], [500, 0.1, 0]),
        ("RADIAL", [500, 0, 0, 0.1, 0.2], [500, 0.1, 0.2]),
        ("OPENCV", [500, 500, 0, 0, 0.1, 0.2, 0, 0], [500, 0.1, 0.2]),
    ],
)
def test_other_models_are_written_exactly(tmp_path: Path, model: str, params, expected) -> None:
    problem = with_cameras(load_bytes(tmp_path, bal_text(*make_bal(13))), model, [params] * 4)
    losses = bundle.save(problem, tmp_path / "out.txt", "bal")
    assert len(losses) == (model != "RADIAL")
    _, observations, cameras, _ = parse_bal((tmp_path / "out.txt").read_bytes())
    np.testing.assert_array_equal(cameras[:, 6:], [expected] * 4)
    np.testing.assert_array_equal(observations[:, 2:] * (1, -1), problem.observation_xy)


def test_principal_points_move_into_the_observations(tmp_path: Path) -> None:
    problem = load_bytes(tmp_path, bal_text(*make_bal(14)))
    params = [[500 + i, 320.5 + i, 240.25 - i, 0.1, 0.01] for i in range(4)]
    shifted = with_cameras(problem, "RADIAL", params)
    losses = bundle.save(shifted, tmp_path / "out.txt")
    assert losses == ("Principal points, up to 323.5 px, are subtracted from the observations.",)
    reloaded = bundle.load(tmp_path / "out.txt")
    np.testing.assert_allclose(
        colmap_residuals(reloaded),
        colmap_residuals(shifted),
        rtol=1e-9,
        atol=1e-9,
    )


def test_everything_lost_is_named(tmp_path: Path) -> None:
    problem = load_bytes(tmp_path, bal_text(*make_bal(15)))
    shared = with_cameras(
        problem,
        "SIMPLE_RADIAL",
        [[500, 1, 0, 0.1], [600, 0, 2, 0.2], [7, 0, 0, 0]],
        image_camera=np.array([0, 0, 1, 0]),
        image_names=("a.jpg", "b.jpg", "c.jpg", "d.jpg"),
        point_ids=np.arange(1, 10),
        camera_sizes=np.full((3, 2), 100),
        observation_keypoint=np.arange(problem.num_observations),
        source=object(),
        format="colmap",
    )
    losses = bundle.save(shared, tmp_path / "out.txt")
    assert losses == (
        "Cameras of model SIMPLE_RADIAL come back as RADIAL.",
        "Cameras shared by several images (1) become one per image.",
        "Cameras without an image (1) are left out.",
        "Principal points, up to 2 px, are subtracted from the observations.",
        "Names of images are left out.",
        "Ids are renumbered from 0: camera, point.",
        "Sizes of images are left out.",
        "Keypoint indices, and keypoints without a point, are left out.",
        "Point colours, rigs, frames and images without a pose are left out.",
    )
    _, _, cameras, _ = parse_bal((tmp_path / "out.txt").read_bytes())
    np.testing.assert_array_equal(cameras[:, 6], [500, 500, 600, 500])


@pytest.mark.parametrize(
    ("model", "params", "found"),
    [
        ("OPENCV_FISHEYE", [500, 500, 0, 0, 0, 0, 0, 0], "found OPENCV_FISHEYE (camera 3)"),
        (
            "PINHOLE",
            [500, 501, 0, 0],
            "expected fx = fy and no tangential distortion, found PINHOLE",
        ),
        ("OPENCV", [500, 500, 0, 0, 0, 0, 0, 1e-9], "found OPENCV (camera 3)"),
    ],
)
def test_cameras_that_do_not_fit_are_named(tmp_path: Path, model: str, params, found: str) -> None:
    problem = load_bytes(tmp_path, bal_text(*make_bal(16)))
    cameras = np.zeros((4, 8))
    cameras[:, 0] = 500.0
    cameras[3, : len(params)] = params
    mixed = problem.replace(
        camera_models=("SIMPLE_RADIAL",) * 3 + (model,),
        camera_params=cameras,
        image_names=("a", "b", "c", "d"),
        image_ids=np.array([1, 2, 3, 77]),
    )
    with pytest.raises(bundle.InputError) as error:
        bundle.save(mixed, tmp_path / "out.txt")
    assert str(error.value).startswith("image 77 (d): a BAL file cannot hold its camera: expected ")
    assert found in str(error.value)
    assert not (tmp_path / "out.txt").exists()
