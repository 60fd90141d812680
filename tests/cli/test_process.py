"""Signals, pipes, names that are not UTF-8, and terminals."""

import json
import os
import pty
import signal
import subprocess
import sys
import time

import pytest

import bundle
from bundle.model.losses import evaluate_loss
from tests.cli.conftest import command, environment
from tests.scenes import scene

# Inexact steps towards a minimum that no rounding lets them reach soon.
ENDLESS = ("--loss", "tukey", "--preconditioner", "identity",
           "--max-iterations", "100000000", "--function-tolerance", "0",
           "--gradient-tolerance", "0", "--parameter-tolerance", "0")  # fmt: skip
INEXACT = {"ceres": "cgnr", "fused": "iterative-schur"}


def test_help_and_version(spawn):
    assert spawn("--version").out == f"bundle {bundle.__version__}\n"
    assert "refine" in spawn("--help").out
    for name in ("info", "refine", "convert", "synth"):
        code, out, err = spawn(name, "--help")
        assert (code, err) == (0, "")
        assert "default: " in out


def run_with_nothing(program):
    """Return the ended process of a program that gives the command line no file to read."""
    return subprocess.run(
        [sys.executable, "-c", program, "info", "/nowhere"],
        env=environment(), capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_process_searches_for_no_garbage_where_there_is_none():
    program = (
        "import atexit, gc, sys\n"
        "from bundle.__main__ import run\n"
        "collections = []\n"
        "gc.callbacks.append(lambda phase, _: collections.append(phase))\n"
        "counts = lambda: print(len(collections), gc.get_freeze_count())\n"
        "atexit.register(counts)\n"
        "sys.exit(run())\n"
    )
    done = run_with_nothing(program)
    assert done.returncode == 2
    collections, frozen = map(int, done.stdout.split())
    assert collections == 0
    assert frozen > 1000  # what the interpreter still has at its end


@pytest.mark.parametrize("earlier", [False, True], ids=["alone", "under a profiler"])
def test_a_process_ends_after_its_last_exit_function(earlier):
    program = (
        "import atexit, os, sys\n"
        f"if {earlier}: atexit.register(print, 'earlier')\n"
        "from bundle import __main__\n"
        "os._exit = print\n"
        "code = __main__.run()\n"
        "atexit.register(print, 'later')\n"
        "sys.exit(code)\n"
    )
    done = run_with_nothing(program)
    assert done.returncode == 2
    assert "error: /nowhere" in done.stderr
    assert done.stdout.split() == ["later", "earlier" if earlier else "2"]


def test_help_shows_every_option_with_its_default(spawn):
    out = " ".join(spawn("refine", "--help-all").out.split())
    assert "default: points-first)" in out
    assert "default: poses,points,focal,extra)" in out
    assert "default: 1e-06)" in out
    assert "PIXELS" in out


def test_interrupted_solve_saves_and_exits_1(tmp_path, backend):
    model, output = tmp_path / "problem.txt", tmp_path / "refined.txt"
    bundle.save(scene(20, 800), model)
    solver = ("--backend", backend, "--solver", INEXACT[backend])
    process = subprocess.Popen(
        command("refine", model, "-o", output, "--json", "-", *solver, *ENDLESS),
        env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        for line in process.stderr:
            if line.split()[:1] == ["2"]:
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "Traceback" not in err
    report = json.loads(out)
    assert report["summary"]["interrupted"]
    assert report["summary"]["final_cost"] < report["summary"]["initial_cost"]
    refined = bundle.load(output)
    errors, _ = bundle.model.residuals.reprojection_errors(refined)
    rho = evaluate_loss("tukey", 1.0, errors**2)
    assert 0.5 * rho[:, 0].sum() == pytest.approx(report["summary"]["final_cost"], rel=1e-9)


def test_interrupted_elsewhere_writes_nothing(tmp_path):
    """A FIFO that nobody writes to: the reader waits until the signal comes."""
    fifo, output = tmp_path / "problem.txt", tmp_path / "refined.txt"
    os.mkfifo(fifo)
    process = subprocess.Popen(
        command("refine", fifo, "-o", output),
        env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        first = process.stderr.readline()
        if "reading" in first:
            time.sleep(0.3)
            process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 130
    assert (first + err).splitlines()[-1].startswith("error: ")
    assert "Traceback" not in err
    assert not output.exists()


def test_reader_that_closes_the_pipe_early(model):
    done = subprocess.run(
        f"{' '.join(command('info', model))} | head -n 1; echo ${{PIPESTATUS[0]}}",
        shell=True, executable="/bin/bash", env=environment(), capture_output=True, text=True,
        timeout=60, check=False,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "0"
    assert "Broken" not in done.stderr
    assert "Exception" not in done.stderr


def test_progress_that_nobody_reads_does_not_stop_the_work(model, tmp_path):
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end) as closed:
        done = subprocess.run(
            command("refine", model, "-o", tmp_path / "r.txt"),
            env=environment(), stdout=subprocess.PIPE, stderr=closed, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 0
    assert (tmp_path / "r.txt").exists()


def test_file_name_that_is_not_utf8(tmp_path):
    name = os.fsencode(tmp_path) + b"/caf\xe9.txt"
    bundle.save(scene(), os.fsdecode(name))
    for encoding in ("utf-8", "ascii"):
        done = subprocess.run(
            [*map(os.fsencode, command("info")), name],
            env={**environment(), "PYTHONIOENCODING": encoding}, capture_output=True, timeout=60,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert rb"caf\udce9.txt(BAL)" in b"".join(done.stdout.split())


def test_terminal_shows_one_updating_line(model, tmp_path):
    controller, terminal = pty.openpty()
    process = subprocess.Popen(
        command("refine", model, "-o", tmp_path / "r.txt", "--max-iterations", 5),
        env={**environment(), "TERM": "xterm", "COLUMNS": "80"}, stdout=subprocess.PIPE,
        stderr=terminal,
    )  # fmt: skip
    os.close(terminal)
    shown = b""
    while True:
        try:
            chunk = os.read(controller, 4096)
        except OSError:  # Linux: the other end is closed
            break
        if not chunk:
            break
        shown += chunk
    os.close(controller)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert b"\x1b" not in out
    assert b"measuring" in shown  # the last stage; others may be too short to be drawn
    assert b"\x1b[2K" in shown  # the line is erased, not left to scroll
    assert b"iteration  " not in shown  # no header of plain lines
