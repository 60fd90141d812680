"""Words of messages and help: values as the command line has them, lines that keep words whole."""

import json
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.base.arrays import as_integers
from bundle.cli.main import COMMANDS, command_parser
from bundle.errors import brief
from tests.cli.conftest import command, environment
from tests.cli.test_bad_input import assert_refused
from tests.scenes import scene


@pytest.mark.parametrize("columns", [50, 80, 100])
@pytest.mark.parametrize("name", COMMANDS)
def test_help_breaks_at_blanks_only(monkeypatch, name, columns):
    parser = command_parser().commands()[name]
    monkeypatch.setenv("COLUMNS", str(columns))
    shown = " ".join(parser.format_help().split())
    for action in parser._actions:
        text = parser._get_formatter()._expand_help(action) if action.help else ""
        for word in text.split():
            assert word in shown


@pytest.mark.parametrize(
    ("arguments", "right", "wrong"),
    [
        (("compare", "--solvers", "foo"), "dense-schur", "_"),
        (("compare", "--preconditioners", "schur_jacob"), "schur-jacobi", "schur_jacobi"),
        (("compare", "--orderings", "points"), "points-first", "points_first"),
        (("refine", "-o", "x", "--refine", "foo"), "principal-point", "_"),
        (("refine", "-o", "x", "--backend", "fused", "--ordering", "cameras-first"),
         "found cameras-first", "_first"),
    ],
)  # fmt: skip
def test_values_are_those_of_the_command_line(run, tmp_path, monkeypatch, arguments, right, wrong):
    monkeypatch.chdir(tmp_path)
    bundle.save(scene(), "p.txt")
    verb, *rest = arguments
    done = run(verb, "p.txt", *rest, "--quiet")
    assert_refused(done, right)
    assert wrong not in done.err.replace("'schur_jacob'", "")


def test_long_words_are_shown_without_their_type():
    for value in ("w" * 200, b"b" * 200):
        assert brief(value).startswith(repr(value)[:40]) and brief(value).endswith("...")
    assert brief(np.zeros(100)).startswith("ndarray ")
    with pytest.raises(bundle.InputError, match="integers, found 'a'"):
        as_integers("ids", ["a"])


CONTENTS = {
    "database.db": b"SQLite format 3\0rest",
    "renamed.txt": b"SQLite format 3\0rest",
    "a.json": b'{"cameras": []}',
    "b.json": b" \n[1, 2]",
    "d.ply": b"ply\nformat ascii 1.0\n",
    "e.xml": b"<?xml version='1.0'?>",
    "f.html": b"<!doctype html>",
    "g.pdf": b"%PDF-1.4",
    "h.png": b"\x89PNG\r\n",
    "i.npz": b"PK\x03\x04",
    "j.csv": b"timestamp,x,y\n",
    "cameras.txt": b"# Camera list with one line of data per camera:\n",
}


@pytest.mark.parametrize("name", CONTENTS)
@pytest.mark.parametrize("verb", ["info", "refine", "check"])
def test_files_of_other_formats_are_named(run, tmp_path, verb, name):
    path = tmp_path / name
    path.write_bytes(CONTENTS[name])
    output = ["-o", tmp_path / "out"] if verb == "refine" else []
    done = run(verb, path, *output, "--quiet")
    assert_refused(done, "BAL file", "COLMAP model", name)
    assert "number of cameras" not in done.err


def test_what_begins_as_a_bal_file_is_read_as_one(run, tmp_path):
    bundle.save(scene(), tmp_path / "p.txt")
    (tmp_path / "p.txt").rename(tmp_path / "p.out")
    assert run("info", tmp_path / "p.out", "--quiet").code == 0
    (tmp_path / "q.txt").write_text("hello")
    assert_refused(run("info", tmp_path / "q.txt", "--quiet"), "number of cameras")


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize("gone", ["rigs", "frames"])
def test_rigs_and_frames_go_together(run, tmp_path, suffix, gone):
    kind = "colmap" if suffix == ".bin" else "colmap-text"
    bundle.save(scene(kind="colmap"), tmp_path / "m", kind)
    (tmp_path / "m" / f"{gone}{suffix}").unlink()
    left = "frames" if gone == "rigs" else "rigs"
    assert_refused(run("info", tmp_path / "m", "--quiet"), f"found {left}{suffix} alone")
    (tmp_path / "m" / f"{left}{suffix}").unlink()
    assert run("info", tmp_path / "m", "--quiet").code == 0


def test_an_old_rig_config_is_named(run, tmp_path):
    bundle.save(scene(kind="colmap"), tmp_path / "m")
    old = [{"ref_camera_id": 1, "cameras": [{"camera_id": 1, "image_prefix": "left/"}]}]
    (tmp_path / "rig.json").write_text(json.dumps(old))
    done = run("info", tmp_path / "m", "--rig-config", tmp_path / "rig.json", "--quiet")
    assert_refused(done, "ref_camera_id", "3.12")


def text_lines(folder: Path) -> list[str]:
    return (folder / "images.txt").read_text().splitlines()


@pytest.mark.parametrize("which", ["all", "second"])
def test_text_without_lines_of_keypoints(run, tmp_path, which):
    bundle.save(scene(kind="colmap"), tmp_path / "m", "colmap-text")
    lines = text_lines(tmp_path / "m")
    first = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    records = lines[first:]
    left = records[::2] if which == "all" else records[:3] + records[4:]
    (tmp_path / "m" / "images.txt").write_text("\n".join([*lines[:first], *left]) + "\n")
    place = first + (2 if which == "all" else 4)
    done = run("info", tmp_path / "m", "--quiet")
    assert_refused(done, f"images.txt:{place}: expected the keypoints of the previous image")


@pytest.mark.parametrize("kind", ["colmap", "colmap-text"])
@pytest.mark.parametrize(("turn", "noted"), [(0.0, False), (1e-6, False), (0.1, True)])
def test_images_that_contradict_frames_are_noted(run, tmp_path, kind, turn, noted):
    """Image poses of one file in a model whose frames say otherwise."""
    problem = scene(kind="colmap")
    bundle.save(problem, tmp_path / "m", kind)
    poses = problem.cam_from_world.copy()
    half = turn / 2
    q = poses[0, :4].copy()
    poses[0, :4] = np.cos(half) * q + np.sin(half) * np.array([q[3], -q[2], q[1], -q[0]])
    bundle.save(problem.replace(cam_from_world=poses), tmp_path / "other", kind)
    suffix = ".bin" if kind == "colmap" else ".txt"
    (tmp_path / "other" / f"images{suffix}").replace(tmp_path / "m" / f"images{suffix}")
    done = run("info", tmp_path / "m", "--quiet")
    assert done.code == 0
    assert done.err.startswith("note: ") == noted
    if noted:
        assert f"1 image has in images{suffix} another pose" in done.err
        assert f"{np.degrees(turn):.3g} degrees" in done.err


def test_a_removed_working_directory_is_named(tmp_path):
    bundle.save(scene(), tmp_path / "p.txt")
    for arguments in (["info", "../p.txt"], ["refine", tmp_path / "p.txt", "-o", "out.txt"]):
        gone = tmp_path / "gone"
        gone.mkdir()
        words = shlex.join(command(*arguments, "--quiet"))
        done = subprocess.run(
            ["sh", "-c", f"cd {gone} && rmdir {gone} && exec {words}"],
            env=environment(), capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 2 and "working directory" in done.stderr
        assert done.stderr.count("error: ") == 1 and "Traceback" not in done.stderr
