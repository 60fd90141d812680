"""`bundle evaluate` from the outside."""

import json

import numpy as np
import pytest

import bundle
from tests.georeference.blocks import block
from tests.io.test_pose_files import LINES
from tests.judging.evaluation import worked_example as example
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem

CONTRACT = (
    *("num_shared", "similarity", "position", "rotation", "auc", "images", "lens_difference"),
    *("headline", "findings", "auc_definition", "input", "reference"),
)


@pytest.fixture
def files(tmp_path):
    for format, lines in LINES.items():
        (tmp_path / f"ref.{format}").write_text("\n".join(lines))
    problem = make_problem(num_images=6, num_points=60)
    bundle.save(problem, f"{tmp_path}/model/")
    bundle.save(bundle.solve(problem).problem, f"{tmp_path}/refined/")
    return tmp_path


def evaluated(run, *words):
    code, out, err = run("evaluate", *words, "--quiet", "--json", "-")
    assert (code, err) == (0, "")
    return json.loads(out)


def test_two_models(run, files):
    report = evaluated(run, files / "refined", "--reference", files / "model")
    assert set(CONTRACT) <= report.keys()
    assert report["num_shared"] == report["input"]["num_images"] == 6
    assert report["input"]["format"] == report["reference"]["format"] == "colmap"
    assert set(report["position"]) == set(report["rotation"]) == {"rmse", "mean", "median", "max"}
    assert set(report["auc"]) == {"1", "3", "5", "10", "30"}
    assert set(report["auc_by_definition"]) == {"trapezoid", "colmap", "histogram", "integral"}
    assert {"name", "position", "rotation", "sigmas"} == report["images"][0].keys()
    assert report["lens_difference"]["rmse"] > 0 and len(report["lens_difference"]["cameras"]) == 6
    assert report["points"]["num_shared"] == 60 and report["movement"]["median_sigmas"] > 0
    same = evaluated(run, files / "model", "--reference", files / "model")
    assert same["verdict"] == "identical" and same["position"]["max"] == 0


@pytest.mark.parametrize("format", LINES)
def test_files_of_poses(run, files, format):
    path = files / f"ref.{format}"
    for words in ([], ["--format", format, "--input-format", format]):
        report = evaluated(run, path, "--reference", path, *words)
        assert report["verdict"] == "identical" and report["num_shared"] == 4
        assert report["lens_difference"] is None and report["movement"] is None
        assert report["unit"] == ("units" if format == "poses" else "m")


def test_pose_graphs_by_their_ids(run, tmp_path):
    rng = np.random.default_rng(3)
    poses = rng.normal(size=(12, 3))
    moved = poses + rng.normal(scale=0.01, size=(12, 3))
    for name, at, ids in (("a", poses, range(12)), ("b", moved[::-1], range(11, -1, -1))):
        rows = zip(ids, at.tolist(), strict=True)
        lines = [f"VERTEX_SE2 {k} {x} {y} {angle}" for k, (x, y, angle) in rows]
        edges = [f"EDGE_SE2 {k} {k + 1} 0 0 0 1 0 0 1 0 1" for k in range(11)]
        (tmp_path / f"{name}.g2o").write_text("\n".join([*lines, *edges]))
    page = tmp_path / "page.html"
    words = (tmp_path / "a.g2o", "--reference", tmp_path / "b.g2o", "--align", "none")
    report = evaluated(run, *words, "--html", page)
    assert report["association"]["by"] == "name" and report["num_shared"] == 12
    assert report["input"]["format"] == report["reference"]["format"] == "g2o"
    off = poses - moved
    assert report["position"]["rmse"] == pytest.approx(np.sqrt((off[:, :2] ** 2).sum(1).mean()))
    assert report["rotation"]["max"] == pytest.approx(np.degrees(np.abs(off[:, 2]).max()))
    assert "12 poses" in report["headline"][0] and page.stat().st_size > 1000
    code, out, err = run("evaluate", *words[:2], tmp_path / "x.g2o", "--quiet")
    assert (code, out, err.count("\n")) == (2, "", 1)


def test_a_model_against_a_list_of_its_poses(run, files):
    problem = bundle.load(files / "refined")
    rows = [
        " ".join([name, *map(repr, [pose[3], *pose[:3], *pose[4:]])])
        for name, pose in zip(problem.image_names, problem.cam_from_world.tolist(), strict=True)
    ]
    (files / "list").write_text("\n".join(rows[::-1]))
    report = evaluated(run, files / "refined", "--reference", files / "list")
    assert report["verdict"] == "identical" and report["association"]["by"] == "name"
    (files / "part").write_text("\n".join(rows[1:5]).replace("image", "x/image"))
    report = evaluated(run, files / "refined", "--reference", files / "part")
    assert report["num_shared"] == 4 and report["association"]["by"] == "base name"
    assert report["missing"] == {"only_in_a": ["image0.jpg", "image5.jpg"], "only_in_b": []}


def test_check_points(tmp_path):
    flight = block(8, pixel_noise=0.3, survey_noise=0.02)
    found = bundle.evaluate(flight.problem, list(flight.gcps))
    assert found.kind == "left_out" and 0 < found.position.rmse < 1
    points = bundle.align(flight.problem, gcps=list(flight.gcps)).control_points
    assert found.errors.tolist() == [list(point.leave_one_out) for point in points]
    assert not np.allclose(found.errors, [point.residual for point in points])
    marked = [
        bundle.GroundControlPoint(
            name=g.name,
            position=g.position,
            measurements=g.measurements,
            role="check" if k > 3 else "control",
        )
        for k, g in enumerate(flight.gcps)
    ]
    checked = bundle.evaluate(flight.problem, marked)
    assert checked.kind == "check" and len(checked.points) == len(marked) - 4
    aligned = bundle.align(flight.problem, gcps=marked)
    rms = np.sqrt((np.array(aligned.rms("check")) ** 2).sum())
    assert checked.position.rmse == pytest.approx(rms)
    assert checked.asdict()["images"] == []
    assert bundle.evaluate(flight.problem, marked[:3]).kind == "fitted"
    assert "points" in repr(checked)
    bundle.html.write_evaluation(checked, tmp_path / "page.html")
    with pytest.raises(bundle.InputError, match="align: "):
        bundle.evaluate(flight.problem, marked, align="rigid")
    with pytest.raises(bundle.InputError, match="expected a model"):
        bundle.evaluate(example.REFERENCE, marked)


def test_rigs_and_partly_the_same_images(run, tmp_path):
    rigs = rig_problem(num_frames=6)
    names = tuple(f"cam{k % 2}/{k // 2:02}.jpg" for k in range(rigs.num_images))
    rigs = rigs.replace(image_names=names)
    part = rigs.without_rigs().select(images=np.arange(2, 9)).problem
    bundle.save(rigs, f"{tmp_path}/rigs/")
    bundle.save(part, f"{tmp_path}/part/")
    report = evaluated(run, tmp_path / "part", "--reference", tmp_path / "rigs")
    assert report["verdict"] == "identical" and report["num_shared"] == 7
    assert len(report["missing"]["only_in_b"]) == rigs.num_images - 7
    assert report["findings"][0]["kind"] == "missing_images"


def test_the_answer_is_in_the_first_six_lines_at_80_columns(spawn, files, monkeypatch):
    words = ("evaluate", files / "refined", "--reference", files / "model", "--quiet")
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = spawn(*words)
    assert code == 0
    lines = out.splitlines()
    assert lines.index("") <= 6 and len(lines) <= 30
    assert all(len(line) <= 80 for line in lines)


def test_the_page(run, files):
    page = files / "page.html"
    words = ("--reference", files / "model", "--quiet", "--html", page)
    code, _, _ = run("evaluate", files / "refined", *words)
    text = page.read_text()
    assert code == 0
    for name in ("paths", "position_errors", "rotation_errors", "sigmas"):
        assert f'data-figure="{name}"' in text
    assert text.count('data-figure="lens_difference_') == 4
    code, _, _ = run(
        "evaluate", files / "ref.tum", "--reference", files / "ref.tum", "--quiet", "--html", page
    )
    assert code == 0 and "are identical" in page.read_text()


MISTAKES = {
    "no reference": (["model"], "--reference"),
    "a missing file": (["model", "--reference", "none"], "none"),
    "other images": (["model", "--reference", "ref.poses"], "--reference: expected at least 3"),
    "two poses": (["two", "--reference", "two"], "found 2 of 2 and 2"),
    "a line": (["line", "--reference", "line"], "A: the 4 shared centres lie on one line"),
    "another format": (["model", "--reference", "ref.tum", "--format", "kitti"], "12 columns"),
    "no poses": (["model", "--reference", "junk.tum"], "junk.tum: line 1"),
    "stamps in ns": (["ref.tum", "--reference", "ns"], "ns: line 1: timestamp"),
    "no stamps in common": (["ref.tum", "--reference", "ref.euroc"], "by time"),
    "a model that is none": (["model", "--reference", "ref.tum", "--format", "colmap"], "ref.tum"),
    "an unknown word": (["model", "--reference", "model", "--align", "sim3"], "--align"),
    "a bad tolerance": (
        ["ref.tum", "--reference", "ref.tum", "--max-time-difference", "-1"],
        "--max-time-difference",
    ),
    "sigmas of poses": (["model", "--reference", "model.poses", "--sigmas", "on"], "--sigmas"),
    "a zero quaternion": (["model", "--reference", "zero"], "zero: line 2"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_one_line(run, files, monkeypatch, mistake):
    monkeypatch.chdir(files)
    words, wanted = MISTAKES[mistake]
    (files / "two").write_text("\n".join(LINES["tum"][:2]))
    (files / "line").write_text("\n".join(f"{k} {k} {k} 0 0 0 0 1" for k in range(4)))
    (files / "ns").write_text("\n".join(f"140363657976355558{k} {k} 0 0 0 0 0 1" for k in range(4)))
    (files / "junk.tum").write_text("x y z\n")
    (files / "zero").write_text("a 1 0 0 0 0 0 0\nb 0 0 0 0 0 0 0\n")
    names = [f"image{k}.jpg" for k in range(4)]
    lines = [line.split(" ", 1)[1] for line in LINES["poses"]]
    (files / "model.poses").write_text(
        "\n".join(f"{n} {x}" for n, x in zip(names, lines, strict=True))
    )
    code, out, err = run("evaluate", *words, "--quiet", "--html", "page.html")
    assert code == 2 and out == ""
    assert err.startswith("error: ") and err.count("\n") == 1 and wanted in err
    assert not (files / "page.html").exists()


def test_a_loss_needs_two_models(run, files):
    words = ("evaluate", files / "ref.tum", "--reference", files / "ref.tum")
    for flags, named in (("--loss huber", "loss"), ("--loss-scale 2", "--loss-scale")):
        code, out, err = run(*words, *flags.split())
        assert (code, out) == (2, "")
        last = err.splitlines()[-1]
        assert last.startswith("error: ") and named in last
