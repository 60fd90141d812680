"""`bundle info` and `bundle convert` from the outside."""

import json

import bundle
from bundle.statistics import describe
from tests.scenes import scene


def test_info_says_what_is_there_and_what_is_wrong(run, tmp_path):
    problem = scene()
    keep = problem.observation_point != 7
    keep[7] = True  # image 0 alone sees point 7
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    path = tmp_path / "odd.txt"
    bundle.save(problem.replace(**{name: getattr(problem, name)[keep] for name in names}), path)
    code, out, err = run("info", path, "--quiet")
    assert (code, err) == (0, "")
    assert "4 images, 4 cameras, 30 points, 117 observations" in out
    assert "RADIAL" in out
    assert "1 connected piece; 100.0 % of the reduced camera matrix" in " ".join(out.split())
    assert "- 1 point is seen only once: the depth is free (point 7)." in out
    assert max(map(len, out.splitlines())) <= 100


def test_info_on_a_sound_problem_finds_nothing(run, model):
    assert "looks wrong       nothing found" in run("info", model, "--quiet").out


def test_info_as_json(run, model, tmp_path):
    path = tmp_path / "info.json"
    assert run("info", model, "--json", path).code == 0
    report = json.loads(path.read_text())
    assert report["command"] == "info"
    assert report["input"]["num_observations"] == 120
    description = describe(bundle.load(model))
    assert report["reprojection_error"]["rmse"] == description.reprojection_error.rmse
    assert report["covisibility"]["neighbours"] == [3, 3, 3, 3]
    assert report["suspicions"] == []
    assert report["track_length"]["histogram"] == [[3, 4, 30]]


def test_info_json_to_standard_output_is_all_there_is(run, model):
    assert json.loads(run("info", model, "--json", "-").out)["schema"] == 1


def test_convert_recompresses_and_loses_nothing(run, model, tmp_path):
    packed = tmp_path / "packed.txt.bz2"
    code, out, _ = run("convert", model, packed, "--json", tmp_path / "r.json")
    assert code == 0
    assert packed.read_bytes().startswith(b"BZh")
    assert "lost              nothing" in out
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["output"] == {"path": str(packed), "format": "bal"}
    assert report["lost"] == []
    first, second = bundle.load(model), bundle.load(packed)
    assert (first.points == second.points).all()


def test_convert_says_what_is_lost(run, tmp_path, monkeypatch):
    shared = scene(kind="colmap", shared_camera=True, camera_sizes=[[640, 480]])
    monkeypatch.setattr("bundle.io.load", lambda _: shared)
    code, out, _ = run("convert", "anything", tmp_path / "r.txt")
    assert code == 0
    assert "- Cameras shared by several images (1) become one an image." in out
    assert "- Sizes of images are left out." in out
