"""Daemon threads that are within a solve when Python exits do not abort the process.

Other calls are not tested: NumPy 2.4 itself aborts, in np.unique for one.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import threading, time
import bundle

problem = bundle.synthesize(num_images=4, num_points=40).problem
started = threading.Event()

def busy():
    total = 0
    for k in range(2000):
        total += k
    return total

def told(iteration):
    started.set()
    busy()

WORK = {
    "solve": lambda: bundle.solve(problem, num_threads=2),
    "ceres": lambda: bundle.solve(problem, backend="ceres", num_threads=2),
    "progress": lambda: bundle.solve(problem, progress=told),
}

def forever():
    while True:
        WORK[KIND]()
        started.set()

for _ in range(3):
    threading.Thread(target=forever, daemon=True).start()
started.wait()
time.sleep(DELAY)
"""


@pytest.mark.parametrize(
    ("kind", "delay"),
    [("solve", 0.0), ("solve", 0.013), ("ceres", 0.03), ("progress", 0.0), ("progress", 0.03)],
)
def test_exit_during_work_of_a_daemon_thread(kind: str, delay: float) -> None:
    script = f"KIND = {kind!r}\nDELAY = {delay}\n{SCRIPT}"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, ""), kind
