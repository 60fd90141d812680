"""`bundle refine --gravity` and `--orientations` from the outside."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.georeference.test_attitude_priors import (
    DOWN,
    gravity_of,
    rotations,
    tilt,
    upright_and_turned,
)
from tests.georeference.test_dji_xmp import attributes, photograph


@pytest.fixture
def model(tmp_path):
    """A COLMAP model in a turned world, and the gravity of its images with noise of 1 degree."""
    truth, given = upright_and_turned()
    bundle.save(given, tmp_path / "model", "colmap")
    write_gravity(tmp_path / "gravity.txt", truth)
    return tmp_path / "model"


def write_gravity(path, truth, upside_down=()):
    rows = zip(truth.image_names, gravity_of(truth, 1.0, upside_down=upside_down), strict=True)
    lines = [f"{name} {' '.join(map(repr, p.direction.tolist()))} 1" for name, p in rows]
    path.write_text("# name down sigma\n" + "\n".join(lines) + "\n")


def refine(run, model, *words):
    out, report = model.parent / "out", model.parent / "r.json"
    return run("refine", model, "-o", out, "--json", report, "--overwrite", *words)


class Solved:
    def __init__(self, path):
        self.problem = bundle.load(path)


def report_of(model):
    return json.loads((model.parent / "r.json").read_text())


def test_models_are_written_upright(run, model, backend):
    code, out, _ = refine(run, model, "--gravity", model.parent / "gravity.txt",
                          "--backend", backend)  # fmt: skip
    assert code == 0
    truth, given = upright_and_turned()
    assert tilt(Solved(model.parent / "out"), truth) < 1
    report = report_of(model)
    found = report["gravity"]
    assert found["within"] < 1 and len(found["images"]) == truth.num_images
    assert {"image", "degrees", "sigmas", "used"} <= set(found["images"][0])
    assert all(image["used"] for image in found["images"])
    assert 0.5 < found["rms_sigmas"] < 1.6
    assert any(line.startswith("Upright within") for line in report["headline"])
    assert "Upright within" in out and " m (median" not in out
    assert not (model.parent / "out" / "georeference.json").exists()
    moved = bundle.load(model.parent / "out").projection_centers
    before = given.projection_centers
    np.testing.assert_allclose(moved.mean(axis=0), before.mean(axis=0), atol=0.1)


def test_wrong_images_are_named(run, model):
    truth, _ = upright_and_turned()
    write_gravity(model.parent / "gravity.txt", truth, upside_down=(3,))
    code, _, _ = refine(run, model, "--gravity", model.parent / "gravity.txt")
    assert code == 0
    (finding,) = [f for f in report_of(model)["findings"] if f["kind"] == "attitudes"]
    assert finding["evidence"]["images"] == ["image3.jpg"]
    assert "--prior-loss tukey" in finding["command"]
    assert refine(run, model, "--gravity", model.parent / "gravity.txt", "--prior-loss", "tukey",
                  "--rounds", "2").code == 0  # fmt: skip
    assert tilt(Solved(model.parent / "out"), truth) < 1


def test_diagnosis_and_covariance_count_them(run, model):
    words = ("--gravity", model.parent / "gravity.txt", "--json", model.parent / "r.json")
    assert run("diagnose", model, *words).code == 0
    assert report_of(model)["nullity"] == report_of(model)["expected_nullity"] == 5
    assert run("covariance", model, "-o", model.parent / "c.npz", *words).code == 0
    page = model.parent / "page.html"
    assert run("report", model, "-o", page, *words).code == 0
    assert page.exists()


def test_parts_and_georeferenced_models_must_be_upright(run, model):
    gravity = model.parent / "gravity.txt"
    code, out, err = refine(run, model, "--gravity", gravity, "--only-images", "1-4")
    assert (code, out) == (2, "")
    assert err.splitlines()[-1].startswith("error: --gravity: expected a model with z up")
    truth, _ = upright_and_turned()
    bundle.save(truth, model.parent / "true", "colmap")
    assert (
        refine(run, model.parent / "true", "--gravity", gravity, "--only-images", "1-4").code == 0
    )
    held = bundle.load(model.parent / "out")
    np.testing.assert_allclose(held.cam_from_world[5:], truth.cam_from_world[5:], atol=1e-12)
    (model / "georeference.json").write_text('{"reference_system": "EPSG:4326", "origin": null}')
    assert refine(run, model, "--gravity", gravity).code == 2


def test_orientations_do_not_bend_a_model_that_must_not_turn(run, model):
    truth, _ = upright_and_turned()
    path = model.parent / "orientations.txt"
    turned = rotations(truth) * Rotation.from_euler("z", 30, degrees=True)
    lines = [
        " ".join([name, *map(repr, rotation.as_quat().tolist())])
        for name, rotation in zip(truth.image_names, turned, strict=True)
    ]
    path.write_text("\n".join(["name qx qy qz qw", *lines]))
    bundle.save(truth, model.parent / "true", "colmap")
    words = ("--orientations", path, "--only-images", "1-4")
    code, out, err = refine(run, model.parent / "true", *words)
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: --orientations: expected a model with axes east, north, up")
    assert "30 degrees" in line
    wide = (*words, "--orientation-sigma", "40/1")
    assert refine(run, model.parent / "true", *wide).code == 0


def test_orientations_and_headings_from_files(run, model):
    truth, _ = upright_and_turned()
    path = model.parent / "orientations.txt"
    lines = [
        " ".join([name, *map(repr, rotation.as_quat().tolist())])
        for name, rotation in zip(truth.image_names, rotations(truth), strict=True)
    ]
    path.write_text("\n".join(["name qx qy qz qw", *lines]))
    assert refine(run, model, "--orientations", path, "--orientation-sigma", "2/0.5").code == 0
    off = rotations(Solved(model.parent / "out").problem).inv() * rotations(truth)
    assert off.mean().magnitude() < np.radians(0.3)
    report = report_of(model)
    assert set(report) >= {"orientations"} and "gravity" not in report
    east, north, _ = rotations(truth).inv().apply([0, 0, 1.0]).T
    level = np.hypot(east, north) > 0.2
    headings = zip(truth.image_names, np.degrees(np.arctan2(east, north)), level, strict=True)
    rows = [f"{name} {heading}" for name, heading, kept in headings if kept]
    path.write_text("\n".join(["name heading", *rows]))
    words = ("--gravity", model.parent / "gravity.txt", "--orientations", path)
    assert refine(run, model, *words).code == 0
    assert {"headings", "gravity"} <= set(report_of(model))


def test_gimbal_angles_from_photographs(run, tmp_path):
    truth, given = upright_and_turned()
    enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    camera = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    (tmp_path / "images").mkdir()
    for name, rotation in zip(truth.image_names, rotations(truth), strict=True):
        body = enu.T @ rotation.as_matrix().T @ camera.T
        yaw, pitch, roll = Rotation.from_matrix(body).as_euler("ZYX", degrees=True)
        names = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")
        values = dict(zip(names, (f"{v:+.6f}" for v in (yaw, pitch, roll)), strict=True))
        photograph(tmp_path / "images" / name, attributes(values))
    bundle.save(given, tmp_path / "model", "colmap")
    words = ("--orientations", "xmp", "--images", tmp_path / "images")
    assert refine(run, tmp_path / "model", *words).code == 0
    off = rotations(Solved(tmp_path / "out").problem).inv() * rotations(truth)
    assert off.mean().magnitude() < np.radians(0.5)
    assert DOWN[2] == -1


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--gravity-sigma", "2"], ["--gravity-sigma", "only with --gravity"]),
        (["--orientation-sigma", "2"], ["--orientation-sigma", "only with --orientations"]),
        (["--gravity", "FILE", "--gravity-sigma", "0"], ["--gravity-sigma", "0"]),
        (["--gravity", "nowhere.txt"], ["nowhere.txt"]),
        (["--gravity", "FILE", "--refine", "points"], ["--gravity", "poses"]),
        (["--gravity", "FILE", "--images", "."], ["--images"]),
        (["--gravity", "FILE", "--prior-loss", "robust"], ["--prior-loss", "robust"]),
        (["--gravity", "FILE", "--prior-loss", "huber", "--prior-loss-scale", "0"], ["-scale:"]),
        (["--orientations", "xmp"], ["--orientations xmp", "--images DIR"]),
        (["--orientations", "FILE"], ["header"]),
        (["--orientations", "xmp", "--images", "nowhere"], ["nowhere"]),
        (["--orientations", "FILE", "--orientation-sigma", "a"], ["--orientation-sigma", "a"]),
    ],
)  # fmt: skip
def test_wrong_flags_are_one_line_and_nothing_is_written(run, model, words, expected):
    named = [str(model.parent / "gravity.txt") if word == "FILE" else word for word in words]
    code, out, err = refine(run, model, *named)
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: ")
    assert all(word in line for word in expected), line
    assert {path.name for path in model.parent.iterdir()} == {"model", "gravity.txt"}


def surveyed(path, truth, kind):
    """Write positions or control points; return their flag."""
    centers = truth.projection_centers
    if kind == "--gps":
        rows = zip(truth.image_names[::6], centers[::6].tolist(), strict=True)
        lines = [f"{name} {' '.join(map(repr, place))}" for name, place in rows]
    else:
        points = np.argsort(-np.bincount(truth.observation_point), kind="stable")[:2].tolist()
        rows = [row for row, p in enumerate(truth.observation_point.tolist()) if p in points]
        lines = []
        for row in rows:
            point = int(truth.observation_point[row])
            place, pixel = truth.points[point].tolist(), truth.observation_xy[row].tolist()
            name = truth.image_names[truth.observation_image[row]]
            lines.append(f"{' '.join(map(repr, place + pixel))} {name} target{point}")
    path.write_text("LOCAL\n" + "\n".join(lines) + "\n")
    return kind, path, f"{kind}-sigma", "0.05"


@pytest.mark.parametrize("kind", ["--gps", "--gcp"])
def test_gravity_determines_the_rotation_about_two_places(run, model, kind):
    """Two positions or control points alone leave it open; so do headings."""
    truth, _ = upright_and_turned()
    given = surveyed(model.parent / "places.txt", truth, kind)
    code, _, err = refine(run, model, *given)
    assert code == 2 and "at least 3" in err
    gravity = ("--gravity", model.parent / "gravity.txt")
    one = model.parent / "one.txt"
    one.write_text(f"LOCAL\n{truth.image_names[0]} 0 0 0\n")
    code, _, err = refine(run, model, "--gps", one, *gravity)
    assert code == 2 and "at least 2" in err
    headings = model.parent / "headings.txt"
    rows = "".join(f"{name} 10 1\n" for name in truth.image_names)
    headings.write_text("name heading sigma_heading\n" + rows)
    code, _, err = refine(run, model, *given, "--orientations", headings)
    assert code == 2 and err.splitlines()[-1].startswith("error: --g")
    code, _, err = refine(run, model, *given, *gravity)
    assert code == 0, err
    places = bundle.load(model.parent / "out").projection_centers
    size = np.ptp(truth.projection_centers, axis=0).max()
    assert np.abs(places - truth.projection_centers).max() < 0.05 * size
