"""`bundle synth`: what is written, what is said, what is refused, and the example data."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bundle
from bundle.synthetic import blocks
from tests.printed import in_order

DATA = Path(__file__).parents[2] / "data"
COMMANDS = re.findall(r"^bundle (synth .*)$", (DATA / "README.md").read_text(), re.MULTILINE)
SMALL = ("--images", 12, "--points", 300, "--track-length", 3)
EXACT = (
    "image_ids", "image_names", "image_camera", "camera_ids", "camera_models", "camera_sizes",
    "point_ids", "observation_image", "observation_point", "observation_keypoint",
)  # fmt: skip
CLOSE = ("cam_from_world", "camera_params", "points", "observation_xy")


def assert_same(found, expected, tolerance):
    for name in EXACT:
        assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in CLOSE:
        assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=tolerance, atol=tolerance,
            err_msg=name,
        )  # fmt: skip


def test_colmap_model_and_truth_beside_it(run, tmp_path):
    path = tmp_path / "model"
    assert run("synth", path, *SMALL, "--seed", 4).code == 0
    scene = bundle.synthesize(num_images=12, num_points=300, mean_track_length=3, seed=4)
    assert_same(bundle.load(path), scene.problem, 1e-12)
    assert_same(bundle.load(tmp_path / "model_ground_truth"), scene.ground_truth, 1e-12)


@pytest.mark.parametrize("suffix", ["", ".txt", ".txt.gz"])
def test_measured_attitudes_are_read_back(run, tmp_path, suffix):
    path = tmp_path / f"scene{suffix}"
    flags = (*SMALL, "--gravity", 1, "--orientations", 2, "--seed", 4)
    outcome = run("synth", path, *flags, "--json", tmp_path / "report.json")
    assert outcome.code == 0
    measured = json.loads((tmp_path / "report.json").read_text())["measured"]
    assert measured == {k: str(tmp_path / f"scene_{k}.txt") for k in ("gravity", "orientations")}
    problem = bundle.load(path)
    known = bundle.georeference.read_attitudes(problem, **measured).priors
    scene = bundle.synthesize(
        num_images=12, num_points=300, mean_track_length=3, seed=4,
        gravity_sigma=1, orientation_sigma=2,
    )  # fmt: skip
    shift = 1 if suffix else 0  # BAL counts from 0
    assert [p.image + shift for p in known] == [p.image for p in scene.priors]
    for found, expected in zip(known, scene.priors, strict=True):
        for name in ("direction", "rotation", "sigma_degrees"):
            if hasattr(expected, name):
                assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-14)
    assert run("synth", path, *flags).code == 2  # the files exist


@pytest.mark.parametrize("suffix", [".txt", ".txt.gz", ".txt.bz2"])
def test_bal_file_and_truth_beside_it(run, tmp_path, suffix):
    path = tmp_path / f"scene.v2{suffix}"
    outcome = run(
        "synth", path, "--scene", "orbit", *SMALL, "--camera-model", "radial", "--cameras",
        "individual",
    )  # fmt: skip
    assert outcome.code == 0
    truth = bundle.load(tmp_path / f"scene.v2_ground_truth{suffix}")
    expected = bundle.synthesize(
        scene="orbit", num_images=12, num_points=300, mean_track_length=3, camera_model="RADIAL",
        cameras="individual",
    ).ground_truth  # fmt: skip
    centered = expected.observation_xy - expected.camera_params[expected.observation_image, 1:3]
    assert_allclose(truth.observation_xy, centered, rtol=1e-12, atol=1e-10)
    assert_allclose(truth.points, expected.points, rtol=1e-12)


def test_paths_of_the_truth(run, tmp_path):
    path, truth = tmp_path / "a", tmp_path / "elsewhere"
    assert run("synth", path, *SMALL, "--ground-truth", truth).code == 0
    assert run("synth", f"{path}.txt/", *SMALL).code == 0
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [
        "a", "a.txt", "a.txt_ground_truth", "elsewhere",
    ]  # fmt: skip


def test_json(run, tmp_path):
    outcome = run(
        "synth", tmp_path / "a", *SMALL, "--scene", "photo-collection", "--outlier-share", 0.1,
        "--image-size", 800, 600, "--json", "-",
    )  # fmt: skip
    report = json.loads(outcome.out)
    options = bundle.SceneOptions(
        scene="photo_collection", num_images=12, num_points=300, mean_track_length=3,
        outlier_share=0.1, image_size=(800, 600),
    )  # fmt: skip
    assert report["schema"] == 1
    assert report["command"] == "synth"
    assert report["version"] == bundle.__version__
    assert bundle.SceneOptions(**report["options"]) == options
    scene = bundle.synthesize(options)
    assert report["output"] == {"path": str(tmp_path / "a"), "format": "colmap"}
    assert report["num_observations"] == scene.problem.num_observations
    assert report["num_outliers"] == scene.is_outlier.sum()
    tracks = np.bincount(scene.problem.observation_point)
    assert report["track_length"]["mean"] == pytest.approx(tracks.mean())
    assert report["track_length"]["max"] == tracks.max()
    errors = report["reprojection_error"]
    assert errors["start"]["median"] > 5 * errors["ground_truth"]["median"]


def test_the_table_names_files_and_counts(run, tmp_path):
    out = run("synth", tmp_path / "a", *SMALL, "--quiet").out
    assert "a_ground_truth" in "".join(out.split())
    problem = bundle.load(tmp_path / "a")
    counts = ["12", "1", "300", str(problem.num_observations)]
    assert in_order(" ".join(out.split()), *counts)


def test_help_has_every_default_and_unit(run, capsys):
    with pytest.raises(SystemExit):
        run("synth", "--help-all")
    text = " ".join(capsys.readouterr().out.split())
    for words in (
        "--images N", "default: 40", "--image-size WIDTH HEIGHT", "default: 1280 960", "in pixels",
        "in degrees", "relative to the scene's scale", "default: photo", "default: street",
        "default: --loop-closure", "default: simple-radial",
    ):  # fmt: skip
        assert (words in text) == (words != "default: photo"), words


def test_outputs_must_not_replace_each_other(run, tmp_path):
    path = tmp_path / "a.txt"
    for clash in (("--ground-truth", path), ("--json", path), ("--json", tmp_path / "b.txt")):
        outcome = run("synth", path, *SMALL, "--ground-truth", tmp_path / "b.txt", *clash)
        assert outcome.code == 2
        assert outcome.err.startswith("error: ")
    for flag in ("--json", "--ground-truth"):
        outcome = run("synth", path, *SMALL, "--gravity", 1, flag, tmp_path / "a_gravity.txt")
        assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_cannot_be_written(run, tmp_path):
    (tmp_path / "file").write_text("mine")
    outcome = run("synth", tmp_path / "file" / "a", *SMALL, "--quiet")
    assert outcome.code == 2
    assert outcome.err.startswith("error: ")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: shlex.split(command)[1])
def test_example_data_is_what_its_command_makes(run, tmp_path, command):
    name, path, *arguments = shlex.split(command)
    made = tmp_path / Path(path).name
    assert run(name, made, *arguments).code == 0
    stem, dot, suffix = made.name.partition(".")
    for entry in (made.name, f"{stem}_ground_truth{dot}{suffix}"):
        assert_same(bundle.load(tmp_path / entry), bundle.load(DATA / entry), 1e-9)


def test_example_data_is_complete_and_small():
    assert len(COMMANDS) == 2
    assert sum(path.stat().st_size for path in DATA.rglob("*") if path.is_file()) < 3e6
    named = {Path(shlex.split(command)[1]).name.partition(".")[0] for command in COMMANDS}
    present = {path.name.partition(".")[0] for path in DATA.iterdir()} - {"README"}
    assert present == named | {f"{name}_ground_truth" for name in named}


def test_large_scenes_are_streamed(run, tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "LARGEST_SINGLE", 300)
    monkeypatch.setattr(blocks, "POINTS_PER_BLOCK", 200)
    monkeypatch.setattr(blocks, "_POINTS_PER_IMAGE", 5)
    flags = ("--images", 10, "--points", 700, "--track-length", 3, "--camera-model", "radial")
    reports = []
    for name in ("a.txt", "b.txt.gz"):  # the second is made in memory
        outcome = run("synth", tmp_path / name, *flags, "--seed", 3, "--json", "-")
        assert outcome.code == 0
        reports.append(json.loads(outcome.out))
        assert len(reports[-1].pop("headline")) == 2
        assert reports[-1].pop("output")["format"] == reports[-1].pop("ground_truth")["format"]
    streamed, whole = (report.pop("reprojection_error") for report in reports)
    assert reports[0] == reports[1]
    for name in ("start", "ground_truth"):
        assert streamed[name].keys() == whole[name].keys()
        for field, value in whole[name].items():
            assert streamed[name][field] == pytest.approx(value, rel=1e-2), field
    assert (tmp_path / "a.txt").read_text().splitlines()[0].endswith(" ")
    first, second = bundle.load(tmp_path / "a.txt"), bundle.load(tmp_path / "b.txt.gz")
    assert_array_equal(first.points, second.points)
    both = (tmp_path / "c.txt", "--ground-truth", tmp_path / "d.txt.gz")
    assert run("synth", *both, *flags, "--seed", 3).code == 0
    assert (tmp_path / "d.txt.gz").read_bytes()[:2] == b"\x1f\x8b"


def test_a_bal_file_says_that_it_has_no_rolling_shutter(run, tmp_path):
    flags = ("--scene", "orbit", "--images", 8, "--points", 150)
    found = run("synth", tmp_path / "a.txt", *flags, "--rolling-shutter", 0.5)
    assert found.code == 0 and "rolling shutter is left out" in " ".join(found.out.split())
    assert "left out" not in run("synth", tmp_path / "b.txt", *flags).out


@pytest.mark.parametrize("scene", ["street", "orbit", "drone-grid"])
def test_a_filmed_scene_and_its_truth(run, tmp_path, scene):
    flags = ("--scene", scene, "--images", 12, "--points", 300, "--rolling-shutter", 0.8)
    assert run("synth", tmp_path / "model", *flags).code == 0
    made = bundle.synthesize(scene=scene, num_images=12, num_points=300, rolling_shutter=0.8)
    assert_same(bundle.load(tmp_path / "model"), made.problem, 1e-12)
    assert_same(bundle.load(tmp_path / "model_ground_truth"), made.ground_truth, 1e-12)


@pytest.mark.parametrize("scene", ["street", "orbit", "photo-collection"])
def test_a_small_scene_needs_no_other_option(run, tmp_path, scene):
    small = ("--images", "3", "--points", "20", "--scene", scene)
    assert run("synth", tmp_path / "model", *small).code == 0
    assert run("info", tmp_path / "model").code == 0
