"""OpenSfM's fisheye62 and fisheye624: exact camera models, and the fit of all other lenses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small


def fisheye624(camera: dict, inside: np.ndarray) -> np.ndarray:
    """Pixels by OpenSfM's Disto624 after its equidistant projection."""
    pixels = []
    for x, y, z in inside.tolist():
        q = np.hypot(x, y)
        u, v = np.arctan2(q, z) / q * np.array([x, y])
        r2 = u * u + v * v
        d = 1 + sum(camera[f"k{i}"] * r2**i for i in range(1, 7))
        p1, p2 = camera["p1"], camera["p2"]
        s = [camera.get(f"s{i}", 0.0) for i in range(4)]
        du = 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + s[0] * r2 + s[1] * r2**2
        dv = 2 * p2 * u * v + p1 * (r2 + 2 * v * v) + s[2] * r2 + s[3] * r2**2
        flat = camera["focal_x"] * (d * u + du), camera["focal_y"] * (d * v + dv)
        pixels.append([flat[0] + camera["c_x"], flat[1] + camera["c_y"]])
    return 800 * np.array(pixels) + [400, 300]


K = {"k1": 0.05, "k2": -0.02, "k3": 0.008, "k4": -0.003, "k5": 1e-3, "k6": -2e-4}
NO_K = dict.fromkeys(K, 0.0)
P = {"p1": 2e-3, "p2": -1e-3}
S = {"s0": 1e-3, "s1": -5e-4, "s2": -2e-3, "s3": 3e-4}


@pytest.mark.parametrize(
    ("terms", "model", "error"),
    [
        (K | {"p1": 0.0, "p2": 0.0}, "RAD_TAN_THIN_PRISM_FISHEYE", 0.0),
        (NO_K | P, "RAD_TAN_THIN_PRISM_FISHEYE", 0.0),
        (NO_K | P | S, "RAD_TAN_THIN_PRISM_FISHEYE", 0.0),
        (K | P | {"k5": 0.0, "k6": 0.0}, "THIN_PRISM_FISHEYE", 0.0),
        (K | P | S | {"k5": 0.0, "k6": 0.0, "s1": 0.0, "s3": 0.0}, "THIN_PRISM_FISHEYE", 0.0),
        (K | {"k5": 0.0, "k6": 0.0, "p1": 0.0, "p2": 0.0}, "OPENCV_FISHEYE", 0.0),
        (K | P, "RAD_TAN_THIN_PRISM_FISHEYE", 0.05),
        (K | P | S, "RAD_TAN_THIN_PRISM_FISHEYE", 0.05),
    ],
)
def test_opensfm_fisheye62_and_fisheye624(tmp_path, terms, model, error) -> None:
    truth = small("RADIAL_FISHEYE", shared=True)
    kind = "fisheye624" if "s0" in terms else "fisheye62"
    camera = {"width": 800, "height": 600, "projection_type": kind, **terms}
    camera |= {"focal_x": 0.6, "focal_y": 0.61, "c_x": 0.01, "c_y": -0.02}
    image = truth.observation_image
    turned = Rotation.from_quat(truth.cam_from_world[image, :4])
    inside = turned.apply(truth.points[truth.observation_point])
    inside += truth.cam_from_world[image, 4:]
    inside[:, :2] *= 3  # wide angles: the poses of the file do not matter
    exact = fisheye624(camera, inside)
    foreign.write_opensfm(truth, tmp_path, cameras={"camera 0": camera})
    problem = bundle.load(tmp_path)
    assert problem.camera_models == (model,)
    found, valid = bundle.project(model, problem.camera_params[0], inside)
    assert valid.all()
    assert np.abs(found - exact).max() <= max(error, 1e-9)
    assert ("fitted" in "".join(problem.source.notes)) == (error > 0)
    if not error:
        bundle.save(problem, tmp_path / "again", "opensfm")
        again = bundle.load(tmp_path / "again")
        assert again.camera_models == (model,)
        np.testing.assert_allclose(again.camera_params, problem.camera_params, rtol=1e-12)
