"""The thread that waits for the signals of mpirun, which is a process of ours here; who speaks."""

import subprocess
import sys

import pytest

from bundle import _core
from bundle.solving.ranks import launch

MPIRUN = """
import signal, subprocess, sys, time
child = subprocess.Popen(
    [sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
)
child.stdout.readline()
child.send_signal(signal.SIGCONT)
time.sleep(0.2)
child.send_signal(signal.SIGTERM)
assert child.wait(10) == 143
"""
PROCESS = """
import os, signal, subprocess, time
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCONT, signal.SIGTERM])
from bundle import _core
_core.wait_for_the_end({mark!r}, 3)
dead = subprocess.Popen(["true"])
dead.wait()
if {knows}: _core.know_processes({{0: os.getpid(), 2: dead.pid}})
print(flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="writes to another process's standard error")
@pytest.mark.parametrize(
    ("knows", "marked", "found"),
    [
        (True, False, "error: process 2 of 3 was lost\n"),
        (False, False, "error: ended by mpirun: Ctrl-C, or a process was lost\n"),
        (True, True, ""),  # another process has said so
    ],
)
def test_one_line_on_the_parents_standard_error(tmp_path, knows, marked, found):
    mark = tmp_path / "mark"
    if marked:
        mark.touch()
    script = PROCESS.format(mark=str(mark), knows=knows)
    done = subprocess.run(
        [sys.executable, "-c", MPIRUN, script],
        stderr=subprocess.PIPE,
        text=True,
        timeout=30,
        check=True,
    )
    assert done.stderr == found
    assert mark.exists()


def test_one_process_takes_the_word(tmp_path):
    mark = str(tmp_path / "mark")
    assert [_core.take_the_word(mark) for _ in range(3)] == [True, False, False]
    assert not _core.take_the_word("")


def test_without_a_folder_of_mpirun(monkeypatch):
    """Another launcher: each process speaks for itself, the first for all."""
    monkeypatch.delenv("PMIX_SERVER_TMPDIR", raising=False)
    for rank, speaks in ((0, True), (1, False)):
        monkeypatch.setenv("PMI_RANK", str(rank))
        assert launch.take_the_word()
        assert launch.speaks_for_all() == speaks
