"""NVM files of other programs: unnormalised quaternions, pixels from the corner, six digits."""

import re
import warnings

import numpy as np
import pytest

import bundle
from bundle.georeference import similarity
from bundle.io.atomic.replaced_paths import NoteWarning
from bundle.model.rigid_motions import rotation_matrices
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small

SIZE = (800, 600)
SHIFT = np.array([400, 300])


def written(folder, change=lambda _, text: text, *, problem=None):
    """Write an NVM file whose camera and point lines are changed; return its problem and path."""
    problem = small("SIMPLE_PINHOLE", shared=True) if problem is None else problem
    path = folder / "m.nvm"
    foreign.write_nvm(problem, path)
    path.write_text("\n".join(map(change, range(10**6), path.read_text().split("\n"))))
    return problem, path


def scaled(length):
    """Multiply the quaternion of the first camera, in line 4 of the file."""

    def change(number, line):
        if number != 3:
            return line
        name, words = line.split("\t")
        numbers = [float(word) for word in words.split()]
        numbers[1:5] = [length * q for q in numbers[1:5]]
        return f"{name}\t" + " ".join(map(repr, numbers))

    return change


@pytest.mark.parametrize("length", [0.901, 1.0018, 1.099])
def test_quaternions_are_normalised(tmp_path, length):
    expected, path = written(tmp_path, scaled(length))
    found = bundle.load(path, image_size=SIZE)
    signs = np.sign((found.cam_from_world[:, :4] * expected.cam_from_world[:, :4]).sum(axis=1))
    np.testing.assert_allclose(
        signs[:, None] * found.cam_from_world[:, :4], expected.cam_from_world[:, :4], atol=1e-12
    )
    np.testing.assert_allclose(found.projection_centers, expected.projection_centers, atol=1e-9)


@pytest.mark.parametrize("length", [0.0, 0.899, 1.101])
def test_other_quaternions_are_refused(tmp_path, length):
    _, path = written(tmp_path, scaled(length))
    with pytest.raises(bundle.InputError, match=r"m.nvm: camera 0: expected a quaternion"):
        bundle.load(path, image_size=SIZE)


def from_corner(folder):
    """Write a file with pixels from the corner, as COLMAP does; return its problem and path."""
    problem = small("SIMPLE_PINHOLE", shared=True)
    params = problem.camera_params.copy()
    params[:, 1:3] = 0.0  # the writer subtracts the principal point
    _, path = written(folder, problem=problem.replace(camera_params=params))
    return problem, path


def test_pixels_from_the_corner(tmp_path):
    expected, path = from_corner(tmp_path)
    found = bundle.load(path, image_size=SIZE, pixel_origin="corner")
    np.testing.assert_allclose(found.observation_xy, expected.observation_xy, rtol=1e-12)
    np.testing.assert_array_equal(found.camera_params[:, 1:3], np.tile([400.0, 300.0], (4, 1)))
    wrong = bundle.load(path, image_size=SIZE)
    np.testing.assert_allclose(wrong.observation_xy, expected.observation_xy + SHIFT)
    # The file that is written has its pixels from the centre.
    bundle.save(found, tmp_path / "again.nvm")
    again = bundle.load(tmp_path / "again.nvm", image_size=SIZE)
    np.testing.assert_allclose(again.observation_xy, found.observation_xy, rtol=1e-12)


def test_pixels_from_the_corner_of_images_of_unknown_size(tmp_path):
    expected, path = from_corner(tmp_path)
    found = bundle.load(path, image_size="unknown", pixel_origin="corner")
    np.testing.assert_allclose(found.observation_xy, expected.observation_xy, rtol=1e-12)
    xy = expected.observation_xy
    middle = (xy.min(axis=0) + xy.max(axis=0)) / 2
    np.testing.assert_allclose(found.camera_params[:, 1:3], np.tile(middle, (4, 1)))
    assert any("middle of the observations" in note for note in found.source.notes)


def test_a_distorted_lens_is_centred_too(tmp_path):
    problem = small("SIMPLE_PINHOLE", shared=True)
    params = problem.camera_params.copy()
    params[:, 1:3] = 0.0
    path = tmp_path / "m.nvm"
    foreign.write_nvm(problem.replace(camera_params=params), path, distortion=0.02)
    corner = bundle.load(path, image_size=SIZE, pixel_origin="corner")
    foreign.write_nvm(problem, path, distortion=0.02)
    center = bundle.load(path, image_size=SIZE)
    np.testing.assert_allclose(corner.observation_xy, center.observation_xy, rtol=1e-12)
    np.testing.assert_allclose(corner.camera_params, center.camera_params, rtol=1e-5)


def test_other_formats_have_one_origin(tmp_path):
    bundle.save(small("RADIAL"), tmp_path / "b.txt", "bal")
    with pytest.raises(bundle.InputError, match=r"expected an NVM file, found .*b.txt"):
        bundle.load(tmp_path / "b.txt", pixel_origin="corner")
    with pytest.raises(bundle.InputError, match=r"^pixel_origin: expected"):
        bundle.load(tmp_path / "b.txt", pixel_origin="left")


def digits(count):
    """Round coordinates to a number of digits, as a stream of C++ does to six."""

    def change(_, line):
        def word(match):
            return f"{float(match[0]):.{count}g}"

        return re.sub(r"(?<![\w.])-?\d+\.\d+(e[-+]\d+)?", word, line)

    return change


def notes(path):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        bundle.load(path, image_size=SIZE)
    return [str(one.message) for one in found if one.category is NoteWarning]


@pytest.mark.parametrize(
    ("offset", "count", "step"),
    [
        (5_412_345.6, 6, "10"),
        (431_234.56, 6, "1"),
        (5_412_345.6, 17, None),  # all digits
        (0.0, 6, None),  # six digits are enough here
        (1234.5, 6, None),  # steps of 0.01 at a depth of hundreds
    ],
)
def test_rounded_coordinates_are_named(tmp_path, offset, count, step):
    problem = moved(small("SIMPLE_PINHOLE", shared=True), offset, 100.0)
    _, path = written(tmp_path, digits(count), problem=problem)
    found = notes(path)
    assert len(found) == (step is not None)
    if step is not None:
        assert f"multiples of {step}," in found[0]
        assert "m.nvm: " in found[0] and "poses and points wrong" in found[0]


def moved(problem, offset, scale):
    """Scale a scene and shift it along x."""
    return similarity.moved(
        problem, similarity.Similarity(scale, np.eye(3), np.array([offset, 0.0, 0.0]))
    )


def test_the_note_begins_at_one_pixel(tmp_path):
    """A step s moves a pixel by f s / d at the median; here s = 1, and the scale sets d."""
    problem = small("SIMPLE_PINHOLE", shared=True)
    image, point = problem.observation_image, problem.observation_point
    distance = np.linalg.norm(problem.points[point] - problem.projection_centers[image], axis=1)
    focal = problem.camera_params[problem.image_camera[image], 0]
    exact = float(np.median(focal / distance))
    for factor, count in ((0.9, 1), (1.1, 0)):
        model = on_whole_numbers(moved(problem, 431_000.0, factor * exact))
        _, path = written(tmp_path, digits(6), problem=model)
        assert len(notes(path)) == count


def on_whole_numbers(problem):
    """Round points and camera centres."""
    poses = problem.cam_from_world.copy()
    centers = np.rint(problem.projection_centers)
    poses[:, 4:] = -np.einsum("nij,nj->ni", rotation_matrices(poses[:, :4]), centers)
    return problem.replace(points=np.rint(problem.points), cam_from_world=poses)


def test_whole_coordinates_near_the_origin_are_not_rounded(tmp_path):
    """A step of 1 moves pixels by more than one here, but three digits are no sign of rounding."""
    problem = on_whole_numbers(moved(small("SIMPLE_PINHOLE", shared=True), 0.0, 100.0))
    _, path = written(tmp_path, problem=problem)
    assert notes(path) == []
    far = on_whole_numbers(moved(small("SIMPLE_PINHOLE", shared=True), 20_000.0, 100.0))
    _, path = written(tmp_path, problem=far)
    assert len(notes(path)) == 1
