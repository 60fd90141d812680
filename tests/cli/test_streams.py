"""Closed, full and broken standard streams, and signals at bad moments."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import bundle
from bundle.cli.error_lines import describe_error
from tests.cli.conftest import command, environment
from tests.scenes import scene


def shell(*arguments, redirect, prefix=""):
    words = prefix + " ".join(map(str, command(*arguments)))
    return subprocess.run(
        f"{words} {redirect}", shell=True, executable="/bin/bash", env=environment(),
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("redirect", [">&-", "2>&-", "<&- >&- 2>&-", "2>/dev/full", "2>&1 | true"])
def test_work_is_done_whoever_listens(model, tmp_path, redirect):
    """A closed stream's number must not go to an output, into which messages would then be put."""
    done = shell("refine", model, "-o", tmp_path / "r.txt", "--json", tmp_path / "r.json",
                 redirect=redirect + "; exit ${PIPESTATUS[0]}")  # fmt: skip
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    assert bundle.load(tmp_path / "r.txt").num_points == 30
    assert (tmp_path / "r.json").read_text().startswith("{")


@pytest.mark.parametrize("redirect", [">&-", "2>&-", ">&- 2>&-", "2>/dev/full"])
def test_the_exit_code_of_an_error_stays(redirect):
    done = shell("info", "missing.txt", "--quiet", redirect=redirect)
    assert done.returncode == 2
    assert done.stderr.count("\n") == (redirect == ">&-")


def test_help_on_odd_streams():
    for redirect, code in ((">&-", 0), ("2>&-", 0), ("| head -1; exit ${PIPESTATUS[0]}", 0),
                           (">/dev/full", 2)):  # fmt: skip
        for arguments in (("refine", "--help"), ("--version",)):
            done = shell(*arguments, redirect=redirect)
            assert done.returncode == code, (redirect, arguments)
            assert "Traceback" not in done.stderr
            assert done.stderr.count("\n") == (code == 2)
    # argparse drops an error of writing, which comes at once without a buffer.
    done = shell("--help", redirect=">/dev/full", prefix="PYTHONUNBUFFERED=1 ")
    assert done.returncode == 2
    assert done.stderr == "error: standard output: No space left on device\n"


def test_what_was_written_before_an_error_is_named(model, tmp_path):
    done = shell("refine", model, "-o", tmp_path / "r.txt", "--quiet", redirect=">/dev/full")
    assert done.returncode == 2
    assert done.stderr.startswith("error: standard output: No space left on device")
    assert done.stderr.endswith("r.txt was written\n")
    done = shell("refine", model, "-o", tmp_path / "r.txt", "--json", "/dev/full", redirect="")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: /dev/full: No space left on device")


def test_messages_about_interruptions_are_true():
    nothing = describe_error(KeyboardInterrupt())
    one = describe_error(KeyboardInterrupt(), [Path("a.txt")])
    two = describe_error(KeyboardInterrupt(), [Path("a.txt"), Path("b"), Path("b")])
    assert nothing == "interrupted; nothing was written"
    assert one == "interrupted; a.txt was written"
    assert two == "interrupted; a.txt and b were written"
    assert describe_error(OSError(28, "No space"), [Path("a")]) == "No space; a was written"
    assert describe_error(ZeroDivisionError(), [Path("a")]) is None
    try:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error
    except ImportError as error:
        assert describe_error(error) == nothing
    assert describe_error(ImportError("no such module")) is None


def interrupting(where: str) -> str:
    """A program that runs the command and gets a SIGINT at a certain call."""
    module, _, name = where.rpartition(".")
    return (
        f"import os, signal, sys, importlib\n"
        f"from bundle.cli.main import main\n"
        f"import bundle.io.open, bundle.reports.terminal.refine, bundle.cli.output\n"
        f"owner = importlib.import_module({module!r}); real = owner.{name}\n"
        f"def interrupted(*a, **k):\n"
        f"    os.kill(os.getpid(), signal.SIGINT)\n"
        f"    return real(*a, **k)\n"
        f"owner.{name} = interrupted\n"
        f"sys.exit(main())\n"
    )


@pytest.mark.parametrize(
    ("where", "written"),
    [("bundle.io.open.load", False), ("bundle.io.bal.save", False),
     ("bundle.io.atomic.atomic_write.flush", False),
     ("bundle.io.atomic.atomic_write.note_replaced", True),
     ("bundle.cli.output.show", True)],
)  # fmt: skip
def test_interrupted_around_the_replacement(model, tmp_path, where, written):
    target = tmp_path / "r.txt"
    target.write_text("old")
    done = subprocess.run(
        [sys.executable, "-c", interrupting(where), "refine", model, "-o", target, "--quiet"],
        env=environment(), capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 130
    ending = f"{target} was written" if written else "nothing was written"
    assert done.stderr == f"error: interrupted; {ending}\n"
    assert (target.read_text() != "old") == written
    assert sorted(child.name for child in tmp_path.iterdir()) == ["problem.txt", "r.txt"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signals_that_end_the_process_leave_old_or_new(tmp_path, number):
    source, target = tmp_path / "in.txt", tmp_path / "out.txt"
    bundle.save(scene(8, 400), source)
    target.write_text("old")
    program = interrupting("bundle.io.atomic.atomic_write.flush").replace("SIGINT", number.name)
    process = subprocess.Popen(
        [sys.executable, "-c", program, "refine", source, "-o", target, "--quiet"],
        env=environment(), stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # nohup ignores SIGHUP for all
    )  # fmt: skip
    _, err = process.communicate(timeout=60)
    assert process.returncode == -number
    assert err == ""
    assert target.read_text() == "old"
    bundle.save(scene(), target)
    assert sorted(child.name for child in tmp_path.iterdir()) == ["in.txt", "out.txt"]


@pytest.mark.parametrize("as_module", [True, False])
def test_interrupted_while_imports_run(model, tmp_path, as_module):
    """From the first line of ours on there is one line and no traceback, whatever is imported."""
    for module in ("numpy", "bundle.base.tables", "bundle.cli.refine"):
        code = (
            "import os, runpy, signal, sys\n"
            "class Interrupt:\n"
            "    def find_spec(self, name, path=None, target=None):\n"
            f"        if name == {module!r}:\n"
            "            os.kill(os.getpid(), signal.SIGINT)\n"
            "sys.meta_path.insert(0, Interrupt())\n"
            + (
                "runpy.run_module('bundle', run_name='__main__', alter_sys=True)\n"
                if as_module
                else "from bundle.__main__ import run; sys.exit(run())\n"
            )
        )
        done = subprocess.run(
            [sys.executable, "-c", code, "refine", model, "-o", tmp_path / "r.txt"],
            env=environment(), capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert done.returncode == 130
        assert done.stderr == "error: interrupted; nothing was written\n"


def test_ctrl_c_again_and_again(tmp_path):
    """Impatience: a signal every few milliseconds, until it has ended."""
    source = tmp_path / "in.txt"
    bundle.save(scene(20, 3000), source)
    process = subprocess.Popen(
        command("refine", source, "-o", tmp_path / "out.txt"),
        # A signal between open() and `with` leaves the file to the garbage collector.
        env=environment() | {"PYTHONWARNINGS": "error,ignore::ResourceWarning"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert "reading" in process.stderr.readline()
    while process.poll() is None:
        os.kill(process.pid, signal.SIGINT)
        time.sleep(0.02)
    err = process.communicate()[1]
    assert "Traceback" not in err
    assert process.returncode in (0, 1, 130)
    assert (tmp_path / "out.txt").exists() == ("nothing was written" not in err)


MOMENTS = {
    # Python keeps in mind that a string's execution was interrupted, even where that is caught.
    "while a string is executed": """
refine.refine = lambda _: exec("raise KeyboardInterrupt")
""",
    # The second signal arrives where no exception would be caught any more.
    "just after the first": """
begin = main._ignoring_interrupts
refine.refine = lambda _: interrupt()
main._ignoring_interrupts = lambda **how: (interrupt(), begin(**how))[1]
""",
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_exit_code_of_an_interrupt_at_a_bad_moment(tmp_path, moment):
    (tmp_path / "program.py").write_text(
        "import os, signal, sys\n"
        "from bundle.__main__ import run\n"
        "from bundle.cli import main as _\n"
        "from bundle.cli import refine\n"
        "main = sys.modules['bundle.cli.main']\n"
        "interrupt = lambda: os.kill(os.getpid(), signal.SIGINT)\n"
        f"{MOMENTS[moment]}\n"
        "sys.exit(run())\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "program", "refine", "in.txt", "-o", tmp_path / "out.txt"],
        cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.stderr == "error: interrupted; nothing was written\n"
    assert done.returncode == 130
