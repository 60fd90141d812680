"""Mistakes of users: one line beginning "error: ", exit code 2, and nothing is written."""

import errno
import os
import resource
import subprocess
from pathlib import Path

import pytest

import bundle
from bundle.cli.error_lines import describe_error
from tests.cli.conftest import command, environment
from tests.printed import in_order
from tests.scenes import scene

UNREADABLE = {
    "missing.txt": None,
    "empty.txt": b"",
    "junk.txt": bytes(range(256)) * 4,
    "truncated.txt": b"4 30 120\n0 0 1.0 2.0\n",
    "cut.txt.bz2": b"BZh91AY&SY",
    "two\nlines.txt": b"4 30",
}


def snapshot(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def assert_refused(outcome, *words):
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("error: ")
    assert outcome.err.count("\n") == 1
    for word in words:
        assert word in outcome.err


@pytest.fixture(params=sorted(UNREADABLE))
def unreadable(request, tmp_path):
    path = tmp_path / request.param
    if UNREADABLE[request.param] is not None:
        path.write_bytes(UNREADABLE[request.param])
    return path


@pytest.mark.parametrize("name", ["info", "refine", "convert"])
def test_input_that_is_no_problem(run, unreadable, tmp_path, name):
    kept = tmp_path / "kept.txt"
    kept.write_text("what stood here before")
    before = snapshot(tmp_path)
    targets = {"info": [], "refine": ["-o", kept], "convert": [kept]}
    stem = unreadable.name.split("\n")[0].split(".")[0]
    report = tmp_path / "report.json"
    assert_refused(run(name, unreadable, *targets[name], "--quiet", "--json", report), stem)
    assert snapshot(tmp_path) == before


def test_problem_without_observations_is_not_refined(run, tmp_path):
    path = tmp_path / "no_images.txt"
    path.write_bytes(b"0 0 0\n")
    before = snapshot(tmp_path)
    assert_refused(run("refine", path, "-o", tmp_path / "r.txt", "--quiet"), "no_images.txt")
    assert snapshot(tmp_path) == before
    assert "There are no observations" in run("info", path, "--quiet").out


def test_folder_that_is_no_model(run, tmp_path):
    (tmp_path / "photos").mkdir()
    assert_refused(run("info", tmp_path / "photos", "--quiet"), "photos", "cameras")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_folder_without_permission(run, model, tmp_path):
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert_refused(run("refine", model, "-o", locked / "r.txt", "--quiet"), "locked")


def test_a_failed_command_leaves_no_new_folder(run, model, tmp_path):
    """The folders of OUTPUT and its reports appear with them, and not after an error."""
    before = snapshot(tmp_path)
    for arguments in (
        ("refine", model, "-o", tmp_path / "a/b/out.txt", "--camera-model", "FISHEYE"),
        ("refine", model, "-o", tmp_path / "a/b/out.txt", "--json", tmp_path / "c/d.html"),
        ("refine", model, "-o", tmp_path / "a/b/out.txt", "--json", model / "r.json"),
        ("convert", model, tmp_path / "a/out", "--format", "opensfm"),
        ("info", tmp_path / "missing", "--json", tmp_path / "c/r.json"),
    ):
        assert_refused(run(*arguments, "--quiet"))
        assert snapshot(tmp_path) == before
    words = ("--json", tmp_path / "c/r.json", "--html", tmp_path / "e/f/r.html", "--quiet")
    assert run("refine", model, "-o", tmp_path / "a/b/out.txt", *words).code == 0
    for name in ("a/b/out.txt", "c/r.json", "e/f/r.html"):
        assert (tmp_path / name).is_file()


def test_disk_that_fills_while_the_model_is_written(tmp_path):
    """The limit on the size of a file stands for the end of the disk."""
    model, kept = tmp_path / "problem.txt", tmp_path / "kept.txt"
    bundle.save(scene(8, 400), model)
    kept.write_text("what stood here before")
    before = snapshot(tmp_path)
    done = subprocess.run(
        command("convert", model, kept, "--quiet"),
        env=environment(), capture_output=True, text=True, timeout=60, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (40000, 40000)),
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert "kept.txt" in done.stderr
    assert snapshot(tmp_path) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("to_file", [True, False])
def test_disk_that_fills_while_the_report_is_written(model, to_file):
    target = "/dev/full" if to_file else "-"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command("info", model, "--quiet", "--json", target),
            env=environment(), stdout=subprocess.PIPE if to_file else full,
            stderr=subprocess.PIPE, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert os.strerror(errno.ENOSPC) in done.stderr
    assert done.stderr.count("\n") == 1
    assert Path("/dev/full").is_char_device()


def test_out_of_memory_and_interruption_are_one_line():
    errors = MemoryError(), MemoryError("3 MB"), KeyboardInterrupt()
    plain, with_size, interrupted = map(describe_error, errors)
    assert plain
    assert "memory" in plain
    assert in_order(with_size, "3 MB")
    assert interrupted
    assert "memory" not in interrupted
    assert "\n" not in plain + with_size + interrupted


def test_a_bug_is_not_dressed_up_as_bad_input(model, monkeypatch):
    from bundle.cli.main import main

    monkeypatch.setattr("bundle.analysis.statistics.description.describe", lambda _: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        main(["info", str(model), "--quiet"])
