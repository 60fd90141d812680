"""Between a problem and pycolmap's reconstruction: pycolmap is the oracle of what arrays mean."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from bundle import InputError, Problem
from bundle.io import colmap
from tests.io.colmap_models import ARRAYS, REAL_MODELS, bal_like, errors_of, fields, synthesize


@pytest.mark.parametrize("name", REAL_MODELS)
def test_arrays_mean_what_pycolmap_projects(bundle_data: Path, name: str) -> None:
    oracle = pycolmap.Reconstruction(bundle_data / "colmap" / name)
    problem = colmap.load(bundle_data / "colmap" / name)
    rng = np.random.default_rng(2)
    for o in rng.choice(problem.num_observations, 300, replace=False):
        i, p = problem.observation_image[o], problem.observation_point[o]
        c = problem.image_camera[i]
        # Not normalised: text files round quaternions, and COLMAP takes them as they are.
        qx, qy, qz, qw = problem.cam_from_world[i, :4]
        rotation = np.array(
            [
                [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
                [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
                [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
            ]
        )
        in_camera = rotation @ problem.points[p] + problem.cam_from_world[i, 4:]
        camera = pycolmap.Camera.create_from_model_name(
            1, problem.camera_models[c], 1.0, *problem.camera_sizes[c].tolist()
        )
        camera.params = problem.camera_params[c, : len(camera.params)].tolist()

        image = oracle.image(int(problem.image_ids[i]))
        point = oracle.point3D(int(problem.point_ids[p]))
        keypoint = image.points2D[int(problem.observation_keypoint[o])]
        assert keypoint.point3D_id == problem.point_ids[p]
        assert keypoint.xy.tolist() == problem.observation_xy[o].tolist()
        assert image.name == problem.image_names[i]
        expected = image.project_point(point.xyz)
        np.testing.assert_allclose(camera.img_from_cam(in_camera), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", REAL_MODELS)
def test_order_and_counts(bundle_data: Path, name: str) -> None:
    oracle = pycolmap.Reconstruction(bundle_data / "colmap" / name)
    problem = colmap.load(bundle_data / "colmap" / name)
    assert problem.num_observations == oracle.compute_num_observations()
    assert problem.camera_ids.tolist() == sorted(oracle.cameras)
    assert problem.image_ids.tolist() == sorted(oracle.reg_image_ids())
    assert problem.point_ids.tolist() == sorted(oracle.points3D)
    keys = np.stack(
        [problem.observation_point, problem.observation_image, problem.observation_keypoint], axis=1
    ).tolist()
    assert keys == sorted(keys)
    assert len(set(map(tuple, keys))) == len(keys)
    assert problem.format == "colmap"


def test_only_refined_numbers_change() -> None:
    source = synthesize(3)
    problem = Problem.from_pycolmap(source)
    rng = np.random.default_rng(3)
    changed = problem.replace(
        cam_from_world=problem.cam_from_world + rng.normal(0, 1e-3, problem.cam_from_world.shape),
        camera_params=problem.camera_params * 1.001,
        points=problem.points + rng.normal(0, 1e-3, problem.points.shape),
    )
    result = changed.to_pycolmap()
    again = Problem.from_pycolmap(result)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(changed, name))

    back = problem.replace(source=result).to_pycolmap()
    assert fields(back) == fields(source)
    oracle = pycolmap.Reconstruction(result)
    oracle.update_point_3d_errors()
    assert errors_of(result) == errors_of(oracle)
    assert errors_of(result) != errors_of(source)


def test_points_have_mean_reprojection_error() -> None:
    source = synthesize(4)
    for point in source.points3D.values():
        point.error = 123.0
    result = Problem.from_pycolmap(source).to_pycolmap()
    for point in result.points3D.values():
        residuals = []
        for element in point.track.elements:
            image = result.image(element.image_id)
            projected = image.project_point(point.xyz)
            residuals.append(np.linalg.norm(projected - image.points2D[element.point2D_idx].xy))
        assert point.error == pytest.approx(np.mean(residuals), rel=1e-9)


def test_later_changes_of_the_caller_do_not_reach_the_problem() -> None:
    source = synthesize(5)
    before = fields(source)
    problem = Problem.from_pycolmap(source)
    first = problem.points.copy()
    for reconstruction in (source, problem.to_pycolmap()):
        for point in reconstruction.points3D.values():
            point.xyz = np.zeros(3)
        for image in reconstruction.images.values():
            image.name = "changed"
    np.testing.assert_array_equal(problem.points, first)
    assert fields(problem.to_pycolmap()) == before


def test_new_reconstruction_shares_cameras_and_keeps_lone_points() -> None:
    problem = bal_like()
    seen = problem.observation_point != 5
    keep = {
        name: getattr(problem, name)[seen]
        for name in ("observation_image", "observation_point", "observation_xy")
    }
    shared = problem.replace(
        image_camera=np.zeros(4), observation_keypoint=np.full(seen.sum(), -1), **keep
    )
    result = shared.to_pycolmap()
    assert {image.camera_id for image in result.images.values()} == {0}
    assert result.point3D(5).track.length() == 0
    assert result.is_valid()


@pytest.mark.parametrize(
    ("array", "value", "message"),
    [
        ("image_ids", -1, "expected image ids from 0 to 4294967294, found -1"),
        ("camera_ids", 2**32 - 1, "expected camera ids from 0 to 4294967294, found 4294967295"),
        ("point_ids", -3, "expected point ids from 0 to 9223372036854775807, found -3"),
    ],
)
def test_ids_that_colmap_cannot_hold(array: str, value: int, message: str) -> None:
    problem = bal_like()
    ids = getattr(problem, array).copy()
    ids[2] = value
    with pytest.raises(InputError, match=message):
        problem.replace(**{array: ids}).to_pycolmap()


def test_reconstruction_whose_references_do_not_resolve() -> None:
    source = synthesize(10)
    image = source.image(min(source.reg_image_ids()))
    spare = next(k for k, point in enumerate(image.points2D) if not point.has_point3D())
    image.set_point3D_for_point2D(spare, 777)
    with pytest.raises(InputError, match=f"image {image.image_id}, keypoint {spare}: .*point 777"):
        Problem.from_pycolmap(source)
    image.reset_point3D_for_point2D(spare)
    image.set_point3D_for_point2D(spare, min(source.points3D))
    with pytest.raises(
        InputError, match=rf"^point {min(source.points3D)}: .*found 6 elements and 7 "
    ):
        Problem.from_pycolmap(source)
    image.reset_point3D_for_point2D(spare)
    source.point3D(min(source.points3D)).track.add_element(image.image_id, spare)
    with pytest.raises(
        InputError, match=rf"^point {min(source.points3D)}: .*found 7 elements and 6 "
    ):
        Problem.from_pycolmap(source)


def test_empty_reconstruction() -> None:
    problem = Problem.from_pycolmap(pycolmap.Reconstruction())
    assert (problem.num_images, problem.num_points, problem.num_observations) == (0, 0, 0)
    assert fields(problem.to_pycolmap()) == fields(pycolmap.Reconstruction())


@pytest.mark.parametrize("element", [(1, 40), (777, 1), (1, 100_000)])
def test_tracks_as_long_as_they_should_be_but_elsewhere(
    element: tuple[int, int], capfd: pytest.CaptureFixture[str]
) -> None:
    source = synthesize(10)
    point = source.point3D(3)
    elements = [pycolmap.TrackElement(*element), *point.track.elements[1:]]
    point.track = pycolmap.Track(elements)
    found = f"found keypoint {element[1]} of image {element[0]}$"
    with pytest.raises(InputError, match=f"^point 3: .*{found}"):
        Problem.from_pycolmap(source)
    assert capfd.readouterr() == ("", "")


def test_a_camera_with_too_few_parameters() -> None:
    source = synthesize(10)
    source.camera(2).params = [900.0, 512.0]
    with pytest.raises(InputError, match=r"^camera 2: expected 4 parameters .*, found 2$"):
        Problem.from_pycolmap(source)
