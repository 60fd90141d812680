"""Delays of poses at 200 Hz while a background solve takes 4 s.

Each run publishes in real time: a pose is due with its sample, and late by the time between that
and its return. Six runs, whose lateness stands side by side: a loop that only sleeps and looks at
the clock, which is what the machine adds by itself; a publisher alone; one beside another process
that solves pose graphs of 5000 poses, which takes a processor away but no interpreter; one whose
closure solve sleeps for 4 s; one whose closure solve does for 4 s what the other process did, on
its thread and in a process as ``bundle.two_loops.ProcessSolver`` has it. The publishing thread has
``bundle.two_loops.deadline_priority``.

python -m tests.campaigns.two_loops [SECONDS]
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

import bundle
from bundle.inertial.two_loops.closure_loop import Keyframe
from bundle.inertial.two_loops.loop_thread import deadline_priority
from bundle.inertial.two_loops.pose_publisher import Solution
from bundle.inertial.two_loops.replay import ProcessSolver, serve
from tests.inertial.two_loops.motion import KEYFRAME_EVERY, RATE, Flight, drifted
from tests.inertial.two_loops.test_loops import SHIFT, YAW, closure_of

STALL = 4.0  # seconds
MANY = 5000
Solver = Callable[[bundle.PoseGraph], np.ndarray]


def sleeping(graph: bundle.PoseGraph) -> np.ndarray:
    """Solve, then wait."""
    poses = bundle.solve(graph, num_threads=1).problem.poses
    time.sleep(STALL)
    return poses


def work(seconds: float) -> None:
    """Solve a large pose graph again and again."""
    rng = np.random.default_rng(0)
    places = np.cumsum(rng.standard_normal((MANY, 3)), axis=0)
    start = np.hstack([np.tile([0, 0, 0, 1.0], (MANY, 1)), places])
    closures = rng.permutation(MANY).reshape(-1, 2)[:2]
    pairs = np.vstack([np.c_[np.arange(MANY - 1), np.arange(1, MANY)], closures])
    between = start[pairs[:, 1]] - start[pairs[:, 0]]
    between[:, :4] = [0, 0, 0, 1]
    between[:, 4:] += 0.1 * rng.standard_normal((len(pairs), 3))
    large = bundle.PoseGraph(
        poses=start,
        edges=pairs,
        measurements=between,
        information=np.tile(np.eye(6), (len(pairs), 1, 1)),
        fixed=np.arange(MANY) == 0,
    )
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        bundle.solve(large, num_threads=1)


def solving(graph: bundle.PoseGraph) -> np.ndarray:
    """Solve, and go on with a large graph."""
    poses = bundle.solve(graph, num_threads=1).problem.poses
    work(STALL)
    return poses


def lateness(seconds: float, solver: Solver | None, *, publishes: bool = True) -> np.ndarray:
    """Return milliseconds by which each pose is late."""
    count = round(seconds * RATE)
    flight = Flight(count)
    window = drifted(flight.states, YAW, SHIFT)
    publisher = flight.publisher()
    loop = bundle.ClosureLoop(publisher.corrections, solver=solver) if solver else None
    late = np.empty(count)
    begun = time.monotonic()
    for k in range(count):
        due = begun + k / RATE
        time.sleep(max(0.0, due - time.monotonic()))
        if publishes:
            if loop is not None and k % KEYFRAME_EVERY == 0:
                loop.put_keyframe(Keyframe(flight.stamps[k], window[k, :7], 1e4))
                if k == RATE:
                    loop.put_closure(closure_of(flight, 0, k))
            if k and k % KEYFRAME_EVERY == 0:
                publisher.solutions.put(Solution(flight.stamps[k - 1], window[k - 1]))
            flight.publish(publisher, k)
        late[k] = 1e3 * (time.monotonic() - due)
    if loop is not None:
        loop.close()
    return late


def beside_another_process(seconds: float) -> np.ndarray:
    """Return milliseconds of a publisher alone, while another process works."""
    command = f"from tests.campaigns.two_loops import work; print(flush=True); work({seconds + 10})"
    with subprocess.Popen([sys.executable, "-c", command], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()  # everything is imported
        late = lateness(seconds, None)
        other.kill()
    return late


class WorkingProcess(ProcessSolver):
    """Its solves take 4 s, which the process works."""

    command = "from tests.campaigns.two_loops import serve_slowly; serve_slowly()"


def serve_slowly() -> None:
    """Solve, and go on with a large graph, for what arrives at standard input."""
    serve(solving)


def in_a_process(seconds: float) -> np.ndarray:
    """Return milliseconds of a publisher whose closures are solved in a process for 4 s."""
    solver = WorkingProcess()
    try:
        return lateness(seconds, solver)
    finally:
        solver.close()


def run(seconds: float) -> dict[str, np.ndarray]:
    """Milliseconds of each run; while the solve lasts, where there is one."""
    stalled = slice(RATE, round((1 + STALL) * RATE))
    return {
        "machine alone": lateness(seconds, None, publishes=False),
        "publisher alone": lateness(seconds, None),
        "a process works": beside_another_process(seconds),
        "solve sleeps 4 s": lateness(seconds, sleeping)[stalled],
        "solve works 4 s": lateness(seconds, solving)[stalled],
        "in a process": in_a_process(seconds)[stalled],
    }


def main() -> None:
    """Print a row per run."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 6.0
    print(f"{'ms late':<18}{'median':>8}{'99 %':>8}{'max':>8}{'over 5 ms':>11}")
    with deadline_priority() as first:
        runs = run(seconds)
    print("the publishing thread comes first" if first else "no thread may come first here")
    for name, late in runs.items():
        median, most = np.percentile(late, [50, 99])
        over = f"{(late > 5).sum()}/{len(late)}"
        print(f"{name:<18}{median:>8.3f}{most:>8.3f}{late.max():>8.3f}{over:>11}")


if __name__ == "__main__":
    main()
