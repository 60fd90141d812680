"""`bundle covariance` from the outside."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.georeference.local_frame import LocalFrame
from tests.scenes import make_problem


@pytest.fixture
def model(tmp_path):
    problem = make_problem(num_images=4, num_points=30, perturbation=0, format="colmap")
    bundle.save(bundle.solve(problem).problem, tmp_path / "model")
    return tmp_path / "model"


def run(*words):
    return main([str(word) for word in words])


def test_file_and_report_hold_what_python_gives(model, tmp_path, capsys):
    target, report = tmp_path / "c.npz", tmp_path / "c.json"
    flags = ("--gauge", "two-cameras", "--scale", "sigma0", "--relative", "1:3", "--quiet")
    flags += ("--verbose",)
    assert run("covariance", model, "-o", target, "--json", report, *flags) == 0
    assert "30 points" in capsys.readouterr().out
    cov = bundle.covariance(model, gauge="two_cameras", scale="sigma0", relative=[(1, 3)])
    with np.load(target) as file:
        assert file["point_covariance"] == pytest.approx(cov.point_covariance)
        assert file["camera_covariance"] == pytest.approx(cov.camera_covariance, nan_ok=True)
        assert file["relative_ids"].tolist() == [[1, 3]]
        assert str(file["gauge"]) == "two_cameras"
    found = json.loads(report.read_text())
    assert found["command"] == "covariance"
    assert found["dof"] == cov.dof
    assert found["sigma0"] == pytest.approx(cov.sigma0)
    assert found["cameras"][0]["sigma"][0] == pytest.approx(np.sqrt(cov.camera(1)[0, 0]))
    assert found["cameras"][0]["sigma"][1] is None  # held
    assert found["relative"][0]["covariance"] == pytest.approx(cov.relative(1, 3))


def test_parts_rules_and_losses(model, tmp_path):
    target = tmp_path / "c.npz"
    flags = ("--of", "intrinsics", "--set", "cameras *: k fixed", "--loss", "cauchy")
    assert run("covariance", model, "-o", target, "--robust", "sandwich", *flags) == 0
    with np.load(target) as file:
        assert len(file["pose_ids"]) == len(file["point_ids"]) == 0
        assert np.isnan(file["camera_covariance"][:, 3, 3]).all()
        assert str(file["robust"]) == "sandwich"


def test_lengths_are_in_metres_where_measurements_determine_the_scale(model, tmp_path, capsys):
    problem = bundle.load(model)
    centers = problem.projection_centers
    fixes = [bundle.PositionPrior(i + 1, centers[i], 0.01) for i in range(4)]
    level = bundle.GravityPrior(1, [0.0, 1.0, 0.0], 1.0)
    assert bundle.covariance(model, priors=fixes).unit == "m"
    assert bundle.influence(model, "baseline 1 2", priors=fixes).unit == "m"
    assert bundle.covariance(model, priors=[level]).unit == bundle.covariance(model).unit == ""

    file, report = tmp_path / "gps.csv", tmp_path / "c.json"
    places = LocalFrame.about([47.0, 8.0, 400.0]).to_geodetic(centers)
    lines = zip(problem.image_names, places.tolist(), strict=True)
    rows = [",".join(map(str, [name, *place])) for name, place in lines]
    file.write_text("\n".join(["image,latitude,longitude,altitude", *rows, ""]))
    words = ("covariance", model, "-o", tmp_path / "c.npz", "--json", report, "--quiet")
    assert run(*words, "--gps", file, "--verbose") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "(median / 95th percentile): rotation [rad]" in said and "length unit" not in said
    assert said.count("translation [m]") == said.count("point [m]") == 2  # headline and table
    assert json.loads(report.read_text())["unit"] == "m"
    assert run(*words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "length unit of the model" in said and "[m]" not in said
    assert json.loads(report.read_text())["unit"] == ""
