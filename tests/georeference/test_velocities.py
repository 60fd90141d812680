"""Files of velocities and DJI's speeds, and the priors that they become."""

import math

import numpy as np
import pytest

from bundle import InputError
from bundle.georeference.exif_gps import read_dji
from bundle.georeference.velocities import read_velocities
from tests.georeference.test_dji_xmp import attributes, photograph
from tests.georeference.test_velocity_priors import filmed, priors_of, velocity_text


@pytest.fixture
def problem():
    return filmed()


def read(problem, tmp_path, text, **settings):
    path = tmp_path / "velocities.csv"
    path.write_text(text)
    return read_velocities(problem, path, **settings).priors


@pytest.mark.parametrize(
    ("text", "velocity", "sigma"),
    [
        ("name vx vy vz\nimage1.jpg 1 2 3\n", (1, 2, 3), (0.5, 0.5, 0.7)),
        ("name,east,north,up\nimage1.jpg, 1, 2, 3\n", (1, 2, 3), (0.5, 0.5, 0.7)),
        ("# flight 3\nname\tnorth\teast\tdown\n2\t2\t1\t-3\n", (1, 2, 3), (0.5, 0.5, 0.7)),
        ("name vx vy vz sigma_horizontal\n2 1 2 3 0.2\n", (1, 2, 3), (0.2, 0.2, 0.2)),
        (
            "name vx vy vz sigma_horizontal sigma_vertical\n2 1 2 nan 0.2 0.4\n",
            (1, 2, math.nan),
            (0.2, 0.2, 0.4),
        ),
    ],
)
def test_columns(problem, tmp_path, text, velocity, sigma):
    (prior,) = read(problem, tmp_path, text, velocity_sigma="0.5/0.7", antenna=(0, 1, 2))
    assert prior.image == problem.image_ids[1]
    np.testing.assert_array_equal(prior.velocity, velocity)
    np.testing.assert_array_equal(prior.sigma, sigma)
    np.testing.assert_array_equal(prior.lever_arm, (0, 1, 2))


def test_written_files_are_read_back(problem, tmp_path):
    names = dict(zip(problem.image_ids.tolist(), problem.image_names, strict=True))
    priors = priors_of(problem)
    again = read(problem, tmp_path, velocity_text(priors, names.__getitem__))
    for prior, other in zip(priors, again, strict=True):
        assert prior.image == other.image
        np.testing.assert_array_equal(prior.velocity, other.velocity)
        np.testing.assert_array_equal(prior.sigma, other.sigma)


HEAD = "name vx vy vz\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["velocities.csv", "0 lines"]),
        (HEAD, ["velocities.csv", "found 0"]),
        ("image1.jpg 1 2 3\n", ["line 1", "header such as name vx vy vz"]),
        ("name vx vz vy\n2 1 2 3\n", ["line 1", "header"]),
        (HEAD + "image1.jpg 1 2\n", ["line 2", "found 2 words"]),
        (HEAD + "image1.jpg 1 2 3 4\n", ["line 2", "found 4 words"]),
        (HEAD + "image1.jpg 1 fast 3\n", ["line 2", "vy", "fast"]),
        (HEAD + "image1.jpg nan 2 3\n", ["line 2", "vx", "nan"]),
        (HEAD + "image1.jpg 1 2 inf\n", ["line 2", "vz", "inf"]),
        (HEAD + "image9.jpg 1 2 3\n", ["line 2", "image9.jpg"]),
        (HEAD + "image1.jpg 1 2 3\n2 1 2 3\n", ["line 3", "again"]),
        ("name vx vy vz sigma_horizontal\n2 1 2 3 0\n", ["line 2", "sigma_horizontal", "0"]),
        ("name vx vy vz sigma_horizontal\n2 1 2 3 -1\n", ["line 2", "sigma_horizontal", "-1"]),
    ],
)
def test_wrong_files_are_one_line(problem, tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        read(problem, tmp_path, text)
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert "\n" not in message


def test_wrong_settings_are_refused(problem, tmp_path):
    text = HEAD + "image1.jpg 1 2 3\n"
    for name, value in (
        ("velocity_sigma", 0), ("velocity_sigma", "a"), ("prior_loss", "square"),
        ("prior_loss_scale", 0), ("antenna", (0, 1)),
    ):  # fmt: skip
        with pytest.raises(InputError):
            read(problem, tmp_path, text, **{name: value})


def test_speeds_of_photographs(problem, tmp_path):
    speeds = {"FlightXSpeed": "+4.10", "FlightYSpeed": "-2.30", "FlightZSpeed": "+0.90"}
    for name in problem.image_names[:2]:
        photograph(tmp_path / name, attributes(speeds))
    photograph(tmp_path / problem.image_names[2], attributes({"FlightXSpeed": "+4.10"}))
    record = read_dji(tmp_path / problem.image_names[0])
    assert (record.north, record.east) == (4.1, -2.3)
    found = read_velocities(problem, "xmp", images=tmp_path).priors
    assert [prior.image for prior in found] == problem.image_ids[:2].tolist()
    np.testing.assert_array_equal(found[0].velocity, (-2.3, 4.1, math.nan))
    with pytest.raises(InputError, match="folder of the images"):
        read_velocities(problem, "xmp")
    other = tmp_path / "other"
    other.mkdir()
    photograph(other / problem.image_names[0], attributes())
    with pytest.raises(InputError, match="speeds in the XMP"):
        read_velocities(problem, "xmp", images=other)


def test_speeds_of_global_shutters_do_not_count(problem, tmp_path):
    for name in problem.image_names:
        photograph(tmp_path / name, attributes({"FlightXSpeed": "1", "FlightYSpeed": "2"}))
    shutter = problem.rolling_shutter
    twist = shutter.twist.copy()
    camera = int(problem.image_camera[0])
    twist[problem.image_camera == camera] = 0
    direction = tuple("global" if k == camera else one for k, one in enumerate(shutter.direction))
    mixed = problem.replace(rolling_shutter=shutter.replace(direction=direction, twist=twist))
    found = read_velocities(mixed, "xmp", images=tmp_path).priors
    rolls = problem.image_ids[problem.image_camera != camera].tolist()
    assert [prior.image for prior in found] == rolls and rolls
