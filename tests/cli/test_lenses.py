"""--camera-model, --share-cameras and --split-cameras from the outside."""

import json

import numpy as np
import pycolmap
import pytest

import bundle
from tests.io.colmap_models import synthesize
from tests.scenes import make_problem


@pytest.fixture
def folder(tmp_path):
    """A COLMAP model of two cameras."""
    (tmp_path / "in").mkdir()
    synthesize(41).write_binary(tmp_path / "in")
    return tmp_path / "in"


def test_convert_changes_the_model_and_says_how(run, folder, tmp_path):
    code, out, _ = run(
        "convert", folder, tmp_path / "out", "--camera-model", "opencv", "--json", tmp_path / "j"
    )
    assert code == 0
    assert "2 cameras became OPENCV, the same lens" in out
    report = json.loads((tmp_path / "j").read_text())["camera_edits"]
    assert [c["camera_id"] for c in report["changes"]] == [1, 2]
    assert all(c["exact"] and c["max"] == 0 for c in report["changes"])
    errors = report["reprojection_error"]
    assert errors["after"]["rmse"] == pytest.approx(errors["before"]["rmse"], rel=1e-9)
    models = {c.model.name for c in pycolmap.Reconstruction(tmp_path / "out").cameras.values()}
    assert models == {"OPENCV"}


def test_a_bad_fit_is_a_warning(run, tmp_path):
    params = np.tile([800.0, 600, 400, 300], (7, 1))
    bundle.save(
        make_problem(num_images=7, model="PINHOLE", camera_params=params), tmp_path / "in", "colmap"
    )
    words = ("--camera-model", "RADIAL", "--verbose")
    code, out, _ = run("convert", tmp_path / "in", tmp_path / "out", *words)
    assert code == 0
    notes = [line for line in out.splitlines() if line.startswith("- ")]
    assert [note.split()[1] for note in notes].count("Camera") == 5
    assert notes[-1].startswith("- 2 other cameras")


def test_refine_starts_with_the_changed_cameras(run, folder, tmp_path):
    code, out, _ = run(
        *("refine", folder, "-o", tmp_path / "out", "--json", tmp_path / "j", "--verbose"),
        *("--camera-model", "RADIAL", "--split-cameras", "--fix-cameras", "3-10"),
    )
    assert code == 0
    report = json.loads((tmp_path / "j").read_text())
    assert report["input"]["num_cameras"] == 2
    assert report["camera_edits"]["num_copies"] == 8
    assert {camera["camera_id"] for camera in report["cameras"]} <= {1, 2}
    assert {camera["model"] for camera in report["cameras"]} == {"RADIAL"}
    assert bundle.load(tmp_path / "out").num_cameras == 10
    assert "8 new cameras" in out


def test_model_first_then_sharing(run, tmp_path):
    params = np.zeros((3, 8))
    params[:, :4] = [800, 400, 300, -0.03]
    params[1, :8] = [800, 800, 400, 300, -0.03, 0, 0, 0]
    models = ["SIMPLE_RADIAL", "OPENCV", "SIMPLE_RADIAL"]
    problem = make_problem(num_images=3, camera_models=models, camera_params=params)
    bundle.save(problem, tmp_path / "in", "colmap")
    flags = ("--camera-model", "OPENCV", "--share-cameras", "all")
    assert run("convert", tmp_path / "in", tmp_path / "out", *flags).code == 0
    found = bundle.load(tmp_path / "out")
    assert found.camera_models == ("OPENCV",)
    np.testing.assert_array_equal(found.camera_params, params[1:2])


@pytest.mark.parametrize(
    ("flags", "found"),
    [
        (("--camera-model", "OPENC"), "error: --camera-model: "),
        (("--camera-model", "EQUIRECTANGULAR"), "error: camera 1: "),
        (("--share-cameras", "1,9"), "error: --share-cameras: "),
        (("--share-cameras", "every"), "error: --share-cameras: "),
        (("--share-cameras", "all", "--split-cameras"), "error: --split-cameras: "),
    ],
)
@pytest.mark.parametrize("command", ["convert", "refine"])
def test_what_cannot_be_done_writes_nothing(run, folder, tmp_path, command, flags, found):
    output = ("-o", tmp_path / "out") if command == "refine" else (tmp_path / "out",)
    code, out, err = run(command, folder, *output, *flags, "--quiet")
    assert (code, out) == (2, "")
    assert err.startswith(found)
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_bal_file_cannot_hold_it(run, model, tmp_path):
    out = tmp_path / "out.txt"
    code, _, err = run("refine", model, "-o", out, "--camera-model", "OPENCV", "--quiet")
    assert code == 2
    assert "a BAL file cannot hold its camera" in err
    assert not out.exists()
