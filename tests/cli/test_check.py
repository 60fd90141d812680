"""`bundle check` and `bundle refine --check-gradients` from the outside."""

from __future__ import annotations

import json

import numpy as np
import pytest

import bundle
from bundle import _core
from tests.printed import figures, table
from tests.scenes import make_problem, scene


@pytest.fixture
def named(tmp_path):
    """A COLMAP model of named images, two of which share a camera."""
    path = tmp_path / "model"
    path.mkdir()
    problem = make_problem(model="RADIAL", num_images=3, num_points=10, shared=True)
    bundle.save(problem, f"{path}/")
    return path


@pytest.fixture
def spoil(monkeypatch):
    """Replace the analytic Jacobians (N, 2, columns) of the core by spoil(them)."""

    def install(change):
        original = _core.check_reprojections

        def check_reprojections(*arguments):
            analytic, *others = original(*arguments)
            change(analytic)
            return (analytic, *others)

        monkeypatch.setattr(_core, "check_reprojections", check_reprojections)

    return install


def double_k1(analytic):
    analytic[..., 9] *= 2


def turn_y(analytic):
    analytic[..., 1] *= -1


def double_k1_sometimes(analytic):
    analytic[::3, :, 9] *= 2
    analytic[..., 1] *= -1


def to_floats(analytic):
    analytic[:] = analytic.astype(np.float32)


def test_correct_jacobians(run, named):
    code, out, err = run("check", named, "--verbose")
    assert code == 0
    rows = table(out)
    assert "30" in figures(rows["checked"][0])
    groups = ("rotation", "translation", "focal", "extra", "point")
    assert {rows[name][0] for name in groups} == {"correct"}
    assert len(err.splitlines()) >= 2
    assert max(map(len, out.splitlines())) <= 100


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (double_k1, ["RADIAL k1: 2.000", "camera 1 k1", "extra", "wrong"]),
        (turn_y, ["rotation y: ", "image image0.jpg rotation y", "point "]),
        (double_k1_sometimes, ["RADIAL k1: 2.000", "10 of 30", "rotation y: "]),
        (to_floats, ["float"]),
    ],
)
def test_wrong_jacobians_are_named(run, named, spoil, change, words):
    spoil(change)
    code, out, _ = run("check", named, "--all", "--quiet")
    assert code == 1
    for word in words:
        assert word in out


def test_json(run, named, spoil, tmp_path):
    spoil(double_k1)
    target = tmp_path / "report.json"
    code, _, _ = run("check", named, "--samples", 4, "--seed", 3, "--json", target)
    assert code == 1
    report = json.loads(target.read_text())
    assert list(report)[:5] == ["schema", "command", "version", "input", "headline"]
    assert (report["schema"], report["command"], report["ok"]) == (1, "check", False)
    assert report["options"]["samples_per_image"] == 4
    assert (report["num_checked"], report["num_skipped"]) == (12, 0)
    (finding,) = report["findings"]
    assert finding["kind"] == "factor"
    assert finding["columns"] == ["RADIAL k1"]
    assert finding["factor"] == pytest.approx(2)
    verdicts = {group["name"]: group["verdict"] for group in report["groups"]}
    assert verdicts == {
        "rotation": "correct",
        "translation": "correct",
        "focal": "correct",
        "principal point": "correct",
        "extra": "wrong",
        "point": "correct",
    }
    worst = report["worst"][0]
    assert worst["parameter"] == "camera 1 k1"
    assert worst["details"]["model"] == "RADIAL"
    assert worst["details"]["image_name"].startswith("image")
    assert worst["analytic"] == pytest.approx(2 * worst["reference"], rel=1e-9)
    assert [entry["error"] for entry in report["worst"]] == sorted(
        (entry["error"] for entry in report["worst"]), reverse=True
    )
    assert sum(entry["count"] for entry in report["histogram"]) == 12 * 2 * (6 + 5 + 3)
    told = run("check", named, "--json", "-", "--quiet")
    assert told.code == 1
    assert json.loads(told.out)["command"] == "check"
    assert "WRONG" in told.err


def test_what_cannot_be_decided_has_an_exit_code_of_its_own(run, named, monkeypatch, tmp_path):
    original = _core.check_reprojections

    def rough(*arguments):
        analytic, reference, uncertainty, *others = original(*arguments)
        uncertainty[..., 9:11] = 1e-3 * np.abs(reference[..., 9:11]).max()  # RADIAL k1, k2
        return (analytic, reference, uncertainty, *others)

    monkeypatch.setattr(_core, "check_reprojections", rough)
    code, out, _ = run("check", named, "--json", tmp_path / "r.json", "--verbose")
    assert code == 3
    assert table(out)["extra"][0] == "undecided"
    report = json.loads((tmp_path / "r.json").read_text())
    assert (report["ok"], report["verdict"]) == (False, "undecided")
    assert [(f["kind"], f["columns"]) for f in report["findings"]] == [("undecided", ["extra"])]
    told = run("check", named, "--json", "-", "--quiet")
    assert told.code == 3
    assert "UNDECIDED" in told.err
    # Nothing is known to be wrong: refine goes on, and says so.
    goes_on = run("refine", named, "-o", f"{tmp_path}/out/", "--check-gradients", "--quiet")
    assert goes_on.code == 0
    assert "UNDECIDED" in goes_on.err


def test_the_sample_is_seeded(run, named, tmp_path):
    reports = []
    for seed in (1, 1, 2):
        target = tmp_path / "r.json"
        assert run("check", named, "--samples", 2, "--seed", seed, "--json", target).code == 0
        report = json.loads(target.read_text())
        del report["wall_time"], report["options"]
        reports.append(report)
    assert reports[0] == reports[1] != reports[2]


def test_nothing_to_check_is_no_failure(run, tmp_path):
    path = tmp_path / "behind.txt"
    problem = scene()
    poses = problem.cam_from_world.copy()
    poses[:, 6] = -6.0
    bundle.save(problem.replace(cam_from_world=poses), path)
    assert run("check", path).code == 0  # BAL counts what is behind a camera
    empty = problem.replace(
        **{
            name: getattr(problem, name)[:0]
            for name in (
                "observation_image",
                "observation_point",
                "observation_xy",
                "observation_keypoint",
            )
        }
    )
    report = bundle.check_jacobians(empty)
    assert report.num_checked == 0
    assert (report.verdict, report.ok) == ("undecided", False)
    assert "Nothing to check" in str(report)


def test_points_behind_the_camera_are_skipped_where_they_do_not_count():
    problem = scene(kind="colmap")
    poses = problem.cam_from_world.copy()
    poses[0, 6] = -6.0
    report = bundle.check_jacobians(problem.replace(cam_from_world=poses))
    assert report
    assert report.num_skipped == 30


def test_refine_checks_first(run, named, spoil, tmp_path):
    output = tmp_path / "refined"
    output.mkdir()
    assert run("refine", named, "-o", f"{output}/", "--check-gradients").code == 0
    assert (output / "cameras.bin").exists()
    other, report = tmp_path / "other.txt", tmp_path / "report.json"
    spoil(turn_y)
    code, out, _ = run(
        "refine", named, "-o", other, "--format", "colmap", "--check-gradients", "--json", report
    )
    assert code == 1
    assert "- rotation y: " in out
    assert not other.exists()
    assert json.loads(report.read_text())["command"] == "check"


@pytest.mark.parametrize(
    "name",
    [
        "bal/problem-16-22106-pre.txt.bz2",
        "bal/problem-21-11315-pre.txt.bz2",
        "bal/problem-49-7776-pre.txt.bz2",
        "colmap/crane_mast",
        "colmap/vr_opencv",
    ],
)
def test_no_false_alarm_on_real_data(bundle_data, name):
    problem = bundle.load(bundle_data / name)
    report = bundle.check_jacobians(problem, samples_per_image=60)
    assert report, report
    assert report.num_checked > 0


def test_the_command_writes_the_page(run, tmp_path):
    problem = make_problem(model="PINHOLE", num_images=2, num_points=8)
    bundle.save(problem, tmp_path / "model")
    page = tmp_path / "check.html"
    code, _, _ = run("check", tmp_path / "model", "--html", page, "--quiet")
    assert code == 0
    assert "Against the step size" in page.read_text()
