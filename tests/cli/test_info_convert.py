"""`bundle info` and `bundle convert` from the outside."""

import json

import pytest

import bundle
from bundle.analysis.statistics.description import describe
from bundle.io.sequences.sequence_folder import save_sequence
from tests.inertial.vio.sequences import sequence
from tests.printed import in_order, table
from tests.scenes import make_problem, scene


def test_info_says_what_is_there_and_what_is_wrong(run, tmp_path):
    problem = scene()
    # Image 0 alone sees point 7.
    keep = (problem.observation_point != 7) | (problem.observation_image == 0)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    path = tmp_path / "odd.txt"
    bundle.save(problem.replace(**{name: getattr(problem, name)[keep] for name in names}), path)
    code, out, err = run("info", path, "--quiet", "--verbose")
    assert (code, err) == (0, "")
    assert in_order(" ".join(out.split()), "BAL", "4", "4", "30", "117")
    assert table(out)["RADIAL"][:2] == ["4", "4"]  # cameras, images
    (found,) = describe(bundle.load(path)).suspicions
    assert (found.kind, found.evidence["count"], found.evidence["ids"]) == (
        "points_seen_once",
        1,
        [7],
    )
    assert found.sentence in " ".join(out.split())
    assert max(map(len, out.splitlines())) <= 100


def test_info_on_a_sound_problem_finds_nothing(run, model, tmp_path):
    assert describe(bundle.load(model)).suspicions == ()
    sound = bundle.synthesize(scene="orbit", num_images=12, num_points=500, seed=1).ground_truth
    bundle.save(sound, f"{tmp_path}/sound/")
    path = tmp_path / "report.json"
    out = run("info", tmp_path / "sound", "--quiet", "--json", path).out
    assert not any(line.startswith("- ") for line in out.splitlines())
    assert json.loads(path.read_text())["findings"] == []


def test_info_names_the_worst_images(run, tmp_path):
    names = [f"photo{i}.jpg" for i in range(6)]
    problem = make_problem(num_images=6, num_points=20, image_names=names)
    poses = problem.cam_from_world.copy()
    poses[3, 4] += 0.1
    bundle.save(problem.replace(cam_from_world=poses), f"{tmp_path}/model/")
    words = ("--json", tmp_path / "report.json", "--verbose")
    code, out, _ = run("info", tmp_path / "model", *words)
    assert code == 0
    worst = json.loads((tmp_path / "report.json").read_text())["worst_images"]
    assert (len(worst), worst[0]["name"]) == (5, "photo3.jpg")
    rows = table(out)
    for image in worst:
        rmse, largest = f"{image['rmse']:.4f}", f"{image['max']:.4f}"
        assert rows[image["name"]] == ["20", rmse, largest]


def test_info_on_several_inputs(run, model, tmp_path):
    other = tmp_path / "other.txt"
    bundle.save(scene(num_points=31), other)
    code, out, err = run("info", model, other, "--json", tmp_path / "report.json")
    assert code == 0
    joined = "".join(out.split())  # a long path goes on in the next line
    assert joined.index(f"{model}(") < joined.index(f"{other}(")
    reports = json.loads((tmp_path / "report.json").read_text())["reports"]
    assert [report["input"]["num_points"] for report in reports] == [30, 31]
    assert [report["input"]["path"] for report in reports] == [str(model), str(other)]
    assert len(err.splitlines()) == 4
    assert out.count("bundle refine") == sum(len(one["findings"]) for one in reports) > 0
    code, out, err = run("info", model, tmp_path / "missing.txt", "--quiet")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert run("info", model, other, "--json", other).code == 2


def test_info_points_to_the_models_of_a_project(run, tmp_path):
    (tmp_path / "garden/sparse").mkdir(parents=True)
    bundle.save(make_problem(), f"{tmp_path}/garden/sparse/0/")
    code, _, err = run("info", tmp_path / "garden")
    assert code == 2
    assert str(tmp_path / "garden/sparse/0") in err


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
    code, _, _ = run("convert", model, packed, "--json", tmp_path / "r.json")
    assert code == 0
    assert packed.read_bytes().startswith(b"BZh")
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["output"] == {"path": str(packed), "format": "bal"}
    assert report["lost"] == []
    first, second = bundle.load(model), bundle.load(packed)
    assert (first.points == second.points).all()


def test_convert_says_what_is_lost(run, tmp_path, monkeypatch):
    shared = scene(kind="colmap", shared_camera=True, camera_sizes=[[640, 480]])
    monkeypatch.setattr("bundle.io.open.load", lambda *_: shared)
    code, out, _ = run("convert", "anything", tmp_path / "r.txt")
    assert code == 0
    lost = bundle.save(shared, tmp_path / "again.txt")
    assert len(lost) >= 2
    said = " ".join(out.split())
    assert all(f"- {sentence}" in said for sentence in lost)


@pytest.mark.parametrize("name", ["imu.csv", "tracks.csv", "calibration.yaml"])
def test_a_report_replaces_no_file_of_a_sequence(run, tmp_path, name):
    save_sequence(sequence(), tmp_path / "s")
    before = (tmp_path / "s" / name).read_bytes()
    done = run("info", tmp_path / "s", "--json", tmp_path / "s" / name)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ") and "would replace" in done.err
    assert (tmp_path / "s" / name).read_bytes() == before


def test_a_rolling_shutter_is_said_and_can_be_removed(run, tmp_path):
    flags = ("--scene", "orbit", "--images", 8, "--points", 200, "--rolling-shutter", 0.8)
    assert run("synth", tmp_path / "model", *flags).code == 0
    truth = tmp_path / "model_ground_truth"
    found = run("info", truth, "--json", "-")
    about = json.loads(found.out)["input"]["rolling_shutter"]
    assert about["cameras"] == [{"camera_id": 1, "direction": "rows", "readout": 0.8}]
    assert about["is_estimated"] and about["num_images"] == 8
    assert "Rolling shutter: rows, readout 0.8" in run("info", truth).out
    found = run("convert", truth, tmp_path / "global", "--global-shutter", "--json", "-")
    moves = json.loads(found.out)["global_shutter"]
    assert moves["num_moved"] > 0 and moves["largest"] > moves["median"] > 0
    assert not (tmp_path / "global" / "rolling_shutter.json").exists()
    again = run("convert", tmp_path / "global", tmp_path / "x", "--global-shutter")
    assert again.code == 2 and not (tmp_path / "x").exists()
    assert again.err.splitlines()[-1].startswith(f"error: --global-shutter: {tmp_path / 'global'}")
    lost = json.loads(run("convert", truth, tmp_path / "x.txt", "--json", "-").out)["lost"]
    assert any("rolling shutter" in sentence for sentence in lost)
