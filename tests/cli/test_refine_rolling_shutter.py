"""`bundle refine` with rolling shutters: flags, files of times, refusals, the report."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.interface.scene_options import SceneOptions
from bundle.io.rolling_shutter_file import neighbours_in_time, read_frame_times
from bundle.synthetic.video_scene import film
from tests import scenes

TIED = ("--twists", "tied", "--twist-sigma", "0.0032,0.0032")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("filmed")
    options = SceneOptions(
        scene="orbit", rolling_shutter=0.8, num_images=12, num_points=250, outlier_share=0.0, seed=4
    )
    made = film(options)
    problem = made.problem.replace(
        camera_params=made.ground_truth.camera_params, rolling_shutter=None
    )
    bundle.save(problem, folder / "model")
    rows = ["image_id,frame"]
    rows += [f"{k},{t}" for k, t in zip(problem.image_ids, made.frames, strict=True)]
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_free_twists_gain(run, model, tmp_path):
    code, out, err = run(
        "refine", model / "model", "-o", tmp_path / "out", "--rolling-shutter", "rows",
        "--refine", "poses,points", "--json", tmp_path / "r.json",
    )  # fmt: skip
    assert code == 0, err
    assert "Rolling shutter: RMSE" in out
    found = json.loads((tmp_path / "r.json").read_text())["rolling_shutter"]
    assert found["rmse"] < 0.5 * found["rmse_global_shutter"]
    assert found["twists"] == "free"
    assert found["twist_rms"]["rotation"] > 0
    again = bundle.load(tmp_path / "out")
    assert again.rolling_shutter.direction == ("rows",)
    assert np.abs(again.rolling_shutter.twist).max() > 0.01


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_an_estimated_readout_has_a_sigma(run, model, tmp_path, backend):
    code, out, err = run(
        "refine", model / "model", "-o", tmp_path / "out", "--rolling-shutter", "rows",
        "--readout", "estimate", "--frames", model / "frames.csv", *TIED, "--backend", backend,
        "--refine", "poses,points", "--json", tmp_path / "r.json",
    )  # fmt: skip
    assert code == 0, err
    assert "readout in frames of camera 1" in out
    camera = json.loads((tmp_path / "r.json").read_text())["rolling_shutter"]["cameras"][0]
    assert abs(camera["readout"] - 0.8) < 5 * camera["readout_sigma"]
    assert 0 < camera["readout_sigma"] < 0.2


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--rolling-shutter", "rows", "--readout", "0"), "readout"),
        (("--rolling-shutter", "rows", "--readout", "1.5"), "readout"),
        (("--rolling-shutter", "rows", "--readout", "0.05", "--frame-rate", "30"), "readout"),
        (("--rolling-shutter", "rows", "--readout", "soon"), "readout"),
        (("--rolling-shutter", "rows", "--readout", "estimate"), "twists"),
        (("--readout", "0.5"), "rolling shutter"),
        (("--rolling-shutter", "rows", *TIED, "--readout", "0.5"), "neighbours"),
        (("--rolling-shutter", "rows", "--frames", "nowhere.csv"), "nowhere.csv"),
        (("--rolling-shutter", "diagonal"), "diagonal"),
        (("--twists", "tied"), "--twist-sigma: "),
        (TIED, "without rolling shutters"),
    ],
)
def test_refusals_are_one_line(run, model, tmp_path, flags, words):
    code, _, err = run("refine", model / "model", "-o", tmp_path / "out", *flags)
    assert code == 2
    errors = [line for line in err.splitlines() if not line.endswith(" ...")]
    assert len(errors) == 1
    assert errors[0].startswith("error: ")
    assert words in errors[0]
    assert not (tmp_path / "out").exists()


def test_seconds_become_shares(run, model, tmp_path):
    code, _, err = run(
        "refine", model / "model", "-o", tmp_path / "out", "--rolling-shutter", "rows",
        "--readout", "0.02", "--frame-rate", "30",
    )  # fmt: skip
    assert code == 0, err
    assert bundle.load(tmp_path / "out").rolling_shutter.readout[0] == pytest.approx(0.6)


def test_times_of_images(tmp_path):
    problem = scenes.make_problem(num_images=5, num_points=10, shared=True)
    path = tmp_path / "times.csv"
    path.write_text("name,time_s\n" + "".join(f"image{k}.jpg,{k / 10}\n" for k in (0, 1, 2, 3)))
    frames, neighbours = read_frame_times(path, problem, 30)
    assert frames[:4].tolist() == [0, 3, 6, 9]
    assert np.isnan(frames[4])
    assert neighbours.tolist() == [[0, 1], [0, 2], [1, 3], [2, 3], [-1, -1]]
    with pytest.raises(bundle.InputError, match="frame-rate"):
        read_frame_times(path, problem)
    path.write_text("image_id,frame,neighbour_a,neighbour_b\n1,0,1,2\n2,x,1,2\n")
    with pytest.raises(bundle.InputError, match=r"times.csv:3: frame: expected a number"):
        read_frame_times(path, problem)
    path.write_text("image_id,stamp\n1,0\n")
    with pytest.raises(bundle.InputError, match="expected columns"):
        read_frame_times(path, problem)


def test_a_long_gap_separates_videos():
    frames = np.array([0.0, 5, 10, 500, 505, np.nan])
    found = neighbours_in_time(frames, np.zeros(6, np.int32))
    assert found.tolist() == [[0, 1], [0, 2], [1, 2], [3, 4], [3, 4], [-1, -1]]
    apart = neighbours_in_time(frames, np.array([0, 1, 0, 1, 0, 0], np.int32))
    assert (apart[1] == [1, 3]).all()


def test_a_shutter_is_no_edit_of_rigs(tmp_path, capsys):
    scene = bundle.synthesize(
        scene="orbit", num_images=12, num_points=150, seed=2, rolling_shutter=0.8
    )
    bundle.save(scene.problem, tmp_path / "in", "colmap")
    given = ["refine", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--json", "-"]
    assert main([*given, "--rolling-shutter", "rows"]) == 0
    assert json.loads(capsys.readouterr().out).get("edits", []) == []
