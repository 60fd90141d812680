"""`bundle refine --database` from the outside."""

import json

import numpy as np
import pycolmap
import pytest

import bundle
from tests.printed import figures
from tests.track_scenes import damaged, synthesize

KEYS = {
    *("round", "triangulated", "completed", "merged", "deleted"),
    *("num_observations", "num_points", "held_out_rmse"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """database.db, truth/ and model/ with few observations."""
    path = tmp_path_factory.mktemp("scene")
    truth = synthesize(path, num_frames_per_rig=6, num_points3D=120)
    bundle.save(damaged(truth, "observations"), path / "model")
    return path


def test_report_and_model(run, folder, tmp_path):
    report, output, page = tmp_path / "report.json", tmp_path / "out", tmp_path / "page.html"
    words = ("--database", folder / "database.db", "--json", report, "--html", page, "--verbose")
    code, out, _ = run("refine", folder / "model", "-o", output, *words)
    assert code == 0
    data = json.loads(report.read_text())
    assert all(set(one) == KEYS for one in data["tracks"])
    assert [one["round"] for one in data["tracks"]] == [one["round"] for one in data["rounds"]]
    assert data["options"]["database"] == str(folder / "database.db")
    assert (data["options"]["num_rounds"], data["options"]["hold_out"]) == (6, 10)
    held = data["held_out"]
    assert held["clipped_rmse"] < data["tracks"][0]["held_out_rmse"]
    model = pycolmap.Reconstruction(output)
    assert model.is_valid()
    assert model.compute_num_observations() == data["tracks"][-1]["num_observations"]
    before = bundle.load(folder / "model").num_observations
    assert model.compute_num_observations() > 2 * before
    numbers = f"{before:,} -> {model.compute_num_observations():,} observations"
    assert sum(numbers in sentence for sentence in data["headline"]) == 1
    scores = (held["clipped_rmse"], data["tracks"][0]["held_out_rmse"])
    told = [figures(sentence) for sentence in data["headline"] if "Held out" in sentence]
    assert [one[1:3] for one in told] == [[f"{score:.4f}" for score in scores]]
    for sentence in data["headline"]:
        assert "".join(sentence.split()) in "".join(out.split())
    assert page.stat().st_size > 10_000
    kept = data["reprojection_error"]["kept"]
    assert kept["num_observations"] == before - data["deleted"]["num_observations"]


def test_options_are_those_of_the_function(run, folder, tmp_path):
    output = tmp_path / "out"
    words = (
        "--database",
        folder / "database.db",
        "--rounds",
        3,
        "--max-error",
        2,
        "--min-angle",
        4,
    )
    words += ("--loss", "huber", "--hold-out", 0, "--min-track", 3)
    assert run("refine", folder / "model", "-o", output, *words)[0] == 0
    expected = bundle.refine_tracks(
        folder / "model", folder / "database.db", num_rounds=3, max_error=2, min_angle=4,
        min_track_length=3, loss="huber", hold_out=0,
    )  # fmt: skip
    found = bundle.load(output)
    np.testing.assert_array_equal(found.observation_keypoint, expected.problem.observation_keypoint)
    np.testing.assert_allclose(found.points, expected.problem.points, atol=1e-6)


REFUSALS = {
    "another file": ["--database", "{folder}/model/images.bin"],
    "no file": ["--database", "{folder}/nothing.db"],
    "other images": ["--database", "{other}"],
    "other keypoints": ["--database", "{keypoints}"],
    "one round": ["--database", "{good}", "--rounds", "1"],
    "constant points": ["--database", "{good}", "--fix-points", "1"],
    "some images": ["--database", "{good}", "--only-images", "1-3"],
    "a checkpoint": ["--database", "{good}", "--checkpoint", "{folder}/x.ckpt"],
    "a checkpoint to resume": ["--database", "{good}", "--resume", "{folder}/x.ckpt"],
    "no points": ["--database", "{good}", "--refine", "poses"],
    "an IMU": [
        *("--database", "{good}", "--imu", "{good}", "--frame-times", "{good}"),
        *("--calibration", "{good}"),
    ],
    "rolling shutters": ["--database", "{good}", "--rolling-shutter", "rows", "--readout", "0.5"],
    "out of core": ["--database", "{good}", "--out-of-core", "{folder}"],
    "limits without rounds": ["--max-error", "3"],
    "a seed without a share": ["--hold-out-seed", "3"],
}


@pytest.fixture(scope="module")
def databases(folder, tmp_path_factory):
    """Databases of other images, and of other keypoints of the same images."""
    path = tmp_path_factory.mktemp("others")
    for name, frames, seed in (("other", 4, 3), ("keypoints", 6, 8)):
        (path / name).mkdir()
        synthesize(path / name, seed, num_frames_per_rig=frames, num_points3D=120)
    return {
        "other": path / "other" / "database.db",
        "keypoints": path / "keypoints" / "database.db",
        "good": folder / "database.db",
        "folder": folder,
    }


@pytest.mark.parametrize("case", REFUSALS)
def test_refusals_are_one_line_and_change_nothing(run, folder, databases, tmp_path, case):
    words = [word.format(**databases) for word in REFUSALS[case]]
    before = sorted((path, path.stat().st_mtime_ns) for path in folder.rglob("*"))
    output = tmp_path / "out"
    code, out, err = run("refine", folder / "model", "-o", output, "--quiet", *words)
    lines = [line for line in err.splitlines() if not line.startswith("note: ")]
    assert (code, out, len(lines)) == (2, "", 1)
    assert lines[0].startswith("error: ")
    assert sorted((path, path.stat().st_mtime_ns) for path in folder.rglob("*")) == before
    assert not output.exists()
