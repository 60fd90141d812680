"""Files of gravity, orientations and headings: forms, units, names, one-line errors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import GravityPrior, HeadingPrior, InputError, OrientationPrior
from bundle.georeference.attitudes import Attitudes, read_attitudes
from tests.scenes import make_problem

PROBLEM = make_problem(num_images=4).replace(
    image_names=("a 1.jpg", "left/b.jpg", "right/b.jpg", "7")
)
ONE, LEFT, RIGHT, SEVEN = PROBLEM.image_ids.tolist()


def read(tmp_path, text, *, as_gravity=True, **settings):
    path = tmp_path / "attitudes.txt"
    path.write_text(text)
    given = {"gravity" if as_gravity else "orientations": path}
    return read_attitudes(PROBLEM, **given, **settings).priors


def test_gravity_by_name_id_and_default_sigma(tmp_path):
    text = '\ufeff# down\r\n"a 1.jpg" 0 9.81 0 0.5\r\n\r\nleft/b.jpg\t0\t0\t-2\r\n3,1,0,0, 2\r\n'
    priors = read(tmp_path, text, gravity_sigma=3.0)
    assert all(isinstance(prior, GravityPrior) for prior in priors)
    assert [prior.image for prior in priors] == [ONE, LEFT, 3]
    assert [prior.sigma_degrees for prior in priors] == [0.5, 3.0, 2.0]
    np.testing.assert_allclose([p.direction for p in priors], [[0, 1, 0], [0, 0, -1], [1, 0, 0]])
    (by_name,) = read(tmp_path, "7 0 1 0 1")  # a name comes before an id
    assert by_name.image == SEVEN


def test_angles_and_both_orders_of_quaternions_are_one_orientation(tmp_path):
    body = Rotation.from_euler("ZYX", (30, -60, 4), degrees=True).as_matrix()
    enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ body
    camera = Rotation.from_matrix((enu @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])).T)
    x, y, z, w = camera.as_quat()
    texts = (
        "name yaw pitch roll sigma_heading sigma_tilt\n7 30 -60 4 8 0.5",
        f"name qx qy qz qw\n7 {x} {y} {z} {w}",
        f"name,qw,qx,qy,qz,sigma_heading\n7,{-w},{-x},{-y},{-z},3",
    )
    for text, sigmas in zip(texts, ((8, 0.5), (5, 1), (3, 3)), strict=True):
        (prior,) = read(tmp_path, text, as_gravity=False)
        assert isinstance(prior, OrientationPrior)
        off = Rotation.from_quat(np.array(prior.rotation)).inv() * camera
        assert off.magnitude() < 1e-7
        assert tuple(prior.sigma_degrees) == sigmas


def test_headings(tmp_path):
    text = "name heading sigma_heading\n7 350 2\nleft/b.jpg -10 4\n"
    priors = read(tmp_path, text, as_gravity=False)
    assert all(isinstance(prior, HeadingPrior) for prior in priors)
    assert [prior.heading_degrees for prior in priors] == [350, -10]
    (prior,) = read(tmp_path, "name heading\n7 1", as_gravity=False, orientation_sigma="9/1")
    assert prior.sigma_degrees == 9


def test_losses_apply_to_all(tmp_path):
    (prior,) = read(tmp_path, "7 0 1 0", prior_loss="tukey")
    assert prior.loss == "tukey" and prior.loss_scale == pytest.approx(2.4477, rel=1e-4)
    (prior,) = read(tmp_path, "7 0 1 0", prior_loss="tukey", prior_loss_scale=0.5)
    assert prior.loss_scale == 0.5
    with pytest.raises(InputError, match="prior_loss_scale: expected more than 0"):
        read(tmp_path, "7 0 1 0", prior_loss_scale=0.0)


BAD_GRAVITY = {
    "": "0",
    "# nothing\n": "0",
    "7 0 1 0 0": "line 1: sigma: expected degrees above 0",
    "7 0 1 0 -1": "line 1: sigma",
    "7 0 1 0 nan": "line 1: sigma",
    "7 0 1 0 1e-200": "line 1: sigma: expected at least",
    "7 0 1 0 1e200": "line 1: sigma: expected at most",
    "7 0 0 0 1": "line 1: expected a direction",
    "7 0 1": "2 words",
    "7 0 1 0 1 5": "5 words",
    "7 0 x 0": "line 1: gy: expected a number",
    "7 0 inf 0": "line 1: gy",
    "nobody.jpg 0 1 0": "nobody.jpg",
    "99 0 1 0": "99",
    "b.jpg 0 1 0": "found 2",
    "7 0 1 0\n\n7 0 1 0": "line 3.*first in line 1",
    '7 0 1 0\n"a 1.jpg" 0 1 0\n1 0 1 0': "line 3.*first in line 2",
}


@pytest.mark.parametrize("text", BAD_GRAVITY)
def test_bad_gravity_is_one_line(tmp_path, text):
    with pytest.raises(InputError, match=BAD_GRAVITY[text]) as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value)
    assert "attitudes.txt" in str(error.value)


BAD_ORIENTATIONS = {
    "": "0 lines",
    "7 1 2 3": "header",
    "name yaw roll pitch\n7 1 2 3": "header",
    "name yaw pitch roll": "found 0",
    "name yaw pitch roll\n7 1 2": "2 words",
    "name qx qy qz qw\n7 0 0 0 0": "quaternion",
    "name heading sigma_heading\n7 1 0": "attitudes.txt: line 2: sigma_heading: .* found 0",
    "name yaw pitch roll sigma_heading sigma_tilt\n7 1 2 3 4 -5": (
        "attitudes.txt: line 2: sigma_tilt: .* found -5"
    ),
}


@pytest.mark.parametrize("text", BAD_ORIENTATIONS)
def test_bad_orientations_are_one_line(tmp_path, text):
    with pytest.raises(InputError, match=BAD_ORIENTATIONS[text]) as error:
        read(tmp_path, text, as_gravity=False)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("sigma", ["0/1", "x", "1/2/3", "-1", "", "nan"])
def test_bad_default_sigmas_are_refused(tmp_path, sigma):
    with pytest.raises(InputError, match="orientation_sigma"):
        read(tmp_path, "name heading\n7 1", as_gravity=False, orientation_sigma=sigma)


def test_files_that_are_not_text_or_do_not_exist(tmp_path):
    path = tmp_path / "binary"
    path.write_bytes(b"\xff\xd8\xff\xe0\x00\x80")
    with pytest.raises(InputError, match="UTF-8"):
        read_attitudes(PROBLEM, gravity=path)
    with pytest.raises(FileNotFoundError):
        read_attitudes(PROBLEM, gravity=tmp_path / "missing")


def test_problems_without_names_use_ids(tmp_path):
    path = tmp_path / "gravity.txt"
    path.write_text("2 0 1 0\n")
    unnamed = PROBLEM.replace(image_names=("",) * 4)
    assert read_attitudes(unnamed, gravity=path).priors[0].image == 2


def test_factors_scale_gravity_and_orientations_apart():
    given = Attitudes((
        GravityPrior(1, (0, 1, 0), 2.0),
        OrientationPrior(2, (0, 0, 0, 1), (5.0, 1.0)),
        HeadingPrior(3, 10.0, 4.0),
    ))  # fmt: skip
    sigmas = [np.asarray(one.sigma_degrees).tolist() for one in given.scaled(3.0, 0.5).priors]
    assert sigmas == [6.0, [2.5, 0.5], 2.0]
    assert given.scaled(1.0, 1.0) is given
