"""Files that a command refuses to replace, and files that it keeps."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.io import recognition
from tests.cli.test_bad_input import assert_refused, snapshot
from tests.io.test_in_place import half_replaced
from tests.scenes import scene

SMALL = ("--images", 12, "--points", 300, "--track-length", 3)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A folder with a model in binary, one in text, one that is neither read nor written, BAL."""
    problem = scene(kind="colmap")
    for name in ("binary", "other"):
        bundle.save(problem, tmp_path / name)
    bundle.save(problem, tmp_path / "text", "colmap-text")
    for suffix in (".txt", ".txt.gz", ".txt.bz2"):
        bundle.save(problem, tmp_path / f"bal{suffix}")
    (tmp_path / "link.json").symlink_to("binary/images.bin")
    return tmp_path


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def work(*_: object, **__: object) -> None:
        pytest.fail("worked for nothing")

    for name in (
        "bundle.solving.rounds.solve_rounds.solve_prepared",
        "bundle.synthetic.synthesis.synthesize",
        "bundle.analysis.statistics.description.describe",
    ):
        monkeypatch.setattr(name, work)


@pytest.mark.parametrize(
    "report",
    ["binary/images.bin", "binary/frames.bin", "binary/cameras.txt", "text/points3D.txt",
     "link.json", "other/cameras.bin", "bal.txt", "bal.txt.gz", "bal.txt.bz2", "new/cameras.bin"],
)  # fmt: skip
@pytest.mark.usefixtures("no_work")
def test_no_report_replaces_a_reconstruction(run, models, report):
    (models / "new").mkdir()
    before = snapshot(models)
    for arguments in (
        ("info", models / "binary", models / "text"),
        ("refine", models / "binary", "-o", models / "text"),
        ("refine", models / "binary", "-o", models / "new"),
        ("inspect", models / "binary", "--html"),
        ("synth", models / "new"),
    ):
        flag = [] if "--html" in arguments else ["--json"]
        if report == "new/cameras.bin" and models / "new" not in arguments:
            continue
        if report == "binary/cameras.txt" and models / "binary" not in arguments:
            continue
        if report == "binary/frames.bin" and "synth" in arguments:
            continue
        words = ["the report would replace"]
        assert_refused(run(*arguments, *flag, models / report, "--quiet"), *words)
    assert snapshot(models) == before


def test_reports_replace_reports_and_any_other_file(run, models):
    for name in ("old.json", "notes.txt", "binary/project.ini"):
        (models / name).write_text("12 apostles")
        assert run("info", models / "binary", "--json", models / name, "--quiet").code == 0
        assert json.loads((models / name).read_text())["command"] == "info"


def test_what_is_a_reconstruction(models):
    found = {name: recognition.reconstruction_at(models / name) for name in (
        "binary", "text", "binary/rigs.bin", "bal.txt", "bal.txt.bz2", ".", "missing",
    )}  # fmt: skip
    assert found == {
        "binary": "a COLMAP model", "text": "a COLMAP model", ".": None, "missing": None,
        "binary/rigs.bin": "a file of a COLMAP model", "bal.txt": "a BAL file",
        "bal.txt.bz2": "a BAL file",
    }  # fmt: skip
    for content in (b"", b"BZh9", b"\x1f\x8b", b"12 34 56\nseven", b"{}", b"1 2 3"):
        (models / "odd").write_bytes(content)
        assert recognition.reconstruction_at(models / "odd") is None


@pytest.mark.parametrize("there", ["binary", "text", "bal.txt", "notes", "folder", "dangling"])
@pytest.mark.parametrize("which", ["output", "ground truth", "ground truth beside"])
def test_synth_replaces_nothing_unless_told(run, models, monkeypatch, there, which):
    (models / "notes").write_text("mine")
    (models / "folder").mkdir()
    (models / "folder" / "thesis.tex").write_text("mine")
    (models / "dangling").symlink_to("nowhere")
    target = models / there
    if which == "ground truth beside":
        target = models / f"start_ground_truth{target.suffix}"
        (models / there).rename(target)
    before = snapshot(models)
    arguments = {
        "output": (target, "--ground-truth", models / "fresh"),
        "ground truth": (models / "fresh", "--ground-truth", target),
        "ground truth beside": (models / f"start{target.suffix}",),
    }[which]
    with monkeypatch.context() as patch:
        patch.setattr(
            "bundle.synthetic.synthesis.synthesize", lambda *_: pytest.fail("worked for nothing")
        )
        assert_refused(run("synth", *arguments, *SMALL, "--quiet"), target.name, "--overwrite")
    assert snapshot(models) == before
    if there in ("binary", "text"):
        assert run("synth", *arguments, *SMALL, "--overwrite", "--quiet").code == 0
        assert bundle.load(target).num_images == 12


def test_names_are_not_lost_by_the_name_of_a_file(run, models):
    """A BAL file has no names: from a COLMAP model it is written only if it is asked for."""
    for suffix in (".txt", ".txt.gz"):
        target = models / f"x{suffix}"
        refused = run("refine", models / "text", "-o", target)
        assert refused.code == 2 and refused.err.splitlines()[-1].startswith("error: ")
        assert "BAL has no names; give --format bal" in refused.err and not target.exists()
        assert run("refine", models / "text", "-o", target, "--format", "bal", "--quiet").code == 0
    assert run("refine", target, "-o", models / "y.txt", "--quiet").code == 0
    assert run("convert", models / "text", models / "z.txt", "--quiet").code == 0


@pytest.mark.parametrize("command", ["refine", "convert"])
def test_a_model_keeps_its_format(run, models, command):
    """In place, over a model in the other format, and in a new folder."""
    flag = ["-o"] if command == "refine" else []
    for source, target, suffix in (
        ("text", "text", ".txt"),
        ("binary", "binary", ".bin"),
        ("binary", "text", ".txt"),
        ("text", "binary", ".bin"),
        ("text", "new_text", ".txt"),
        ("text", "new_text_too/", ".txt"),
        ("binary", "new_binary", ".bin"),
    ):
        outcome = run(command, models / source, *flag, f"{models}/{target}", "--quiet")
        assert outcome.code == 0, outcome.err
        assert {file.suffix for file in (models / target).iterdir()} == {suffix}
        assert bundle.load(models / target).num_points == 30
    outcome = run(command, models / "text", *flag, models / "text", "--format", "colmap", "--quiet")
    assert outcome.code == 0
    assert "points3D.txt" in outcome.out
    assert {file.suffix for file in (models / "text").iterdir()} == {".bin"}


def test_both_formats_in_one_folder(run, models):
    """Binary is read, as COLMAP does; the text would contradict it, and goes not without a word."""
    both = models / "binary"
    for file in (models / "text").iterdir():
        file.rename(both / file.name)
    outcome = run("convert", both, both, "--quiet")
    assert "cameras.txt" in outcome.out
    assert {file.suffix for file in both.iterdir()} == {".bin"}


@pytest.mark.parametrize(
    ("model", "params", "refined", "refused"),
    [
        ("PINHOLE", [500, 500, 320, 240], "poses,points,focal", True),
        ("PINHOLE", [500, 500, 320, 240], "poses,points,extra", False),
        ("OPENCV", [500, 500, 320, 240, 0, 0, 0, 0], "poses,extra", True),
        ("OPENCV", [500, 500, 320, 240, 0, 0, 0, 0], "poses,principal-point", False),
        ("SIMPLE_RADIAL", [500, 320, 240, 0], "poses,focal,extra", False),
    ],
)
def test_bal_output_that_the_solve_would_make_impossible(
    run, tmp_path, monkeypatch, model, params, refined, refused
):
    problem = scene(kind="colmap").replace(
        camera_models=(model,) * 4,
        camera_params=np.tile(np.array(params, float), (4, 1)),
    )
    bundle.save(problem, tmp_path / "in")
    arguments = (
        "refine",
        tmp_path / "in",
        "-o",
        tmp_path / "out.txt",
        "--format",
        "bal",
        "--refine",
        refined,
        "--quiet",
    )
    if refused:
        with monkeypatch.context() as patch:
            patch.setattr(
                "bundle.solving.rounds.solve_rounds.solve_prepared",
                lambda *_, **__: pytest.fail("solved for nothing"),
            )
            assert_refused(run(*arguments), model, "BAL")
        assert not (tmp_path / "out.txt").exists()
        ids = ",".join(map(str, bundle.load(tmp_path / "in").camera_ids))
        arguments += ("--fix-cameras", ids)
    assert run(*arguments).code in (0, 1)


@pytest.mark.parametrize("arguments", [("info", "MODEL"), ("convert", "BAL", "MODEL")])
def test_a_finished_replacement_is_noted(spawn, models, arguments):
    """Leftovers of a killed run on a system that cannot exchange folders."""
    half_replaced(models / "binary")
    names = {"MODEL": models / "binary", "BAL": models / "bal.txt"}
    paths = [names.get(argument, argument) for argument in arguments]
    code, _, err = spawn(*paths, "--quiet")
    assert code == 0
    assert err.startswith(f"note: {models / 'binary'}: finished the replacement")
    assert err.count("\n") == 1
    assert spawn(*paths, "--quiet").err == ""
    assert bundle.load(models / "binary").num_points == 30


def test_text_output_without_names_is_refused_before_the_solve(tmp_path):
    bundle.save(scene(kind="colmap"), tmp_path / "in")
    problem = bundle.load(tmp_path / "in")
    nameless = problem.replace(image_names=("a", "", "b", "c"))
    with pytest.raises(bundle.InputError, match="expected a name"):
        bundle.io.open.check_target(nameless, tmp_path / "out", "colmap-text")
    bundle.io.open.check_target(nameless, tmp_path / "out", "colmap")


@pytest.mark.parametrize("output", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "/dev/null"])
@pytest.mark.parametrize("format", ["bal", "colmap"])
@pytest.mark.usefixtures("no_work")
def test_no_model_goes_to_a_stream(run, model, output, format):
    for arguments in (("refine", model, "-o", output), ("convert", model, output)):
        assert_refused(run(*arguments, "--format", format, "--quiet"), "device or pipe")


def test_reports_go_to_streams(spawn, model, tmp_path):
    """Also where standard output is a file: that file is not taken from under the report."""
    path, name = tmp_path / "out", model.relative_to(tmp_path)  # no line breaks by a long path
    with path.open("w") as out:
        inode = os.fstat(out.fileno()).st_ino
        spawn("info", name, "--json", "/dev/stdout", "--quiet", stdout=out, cwd=tmp_path)
    assert path.stat().st_ino == inode
    text, _, report = path.read_text().partition("{")
    assert "4 images" in text
    assert json.loads("{" + report)["command"] == "info"
    words = ("inspect", name, "--html", "/dev/stdout", "--json", "/dev/null", "--quiet")
    code, out, _ = spawn(*words, cwd=tmp_path)
    assert code == 0
    assert "<!doctype html>" in out
    assert "recommended" in out
