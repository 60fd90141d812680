"""Solver of pose graphs in a separate process, at a lower priority.

A solve on a thread shares the interpreter with the thread that publishes poses. Each Python call of
the solve, and each copy of an array, may hold the interpreter. If the system suspends the thread at
this time, a pose is late. A separate process shares nothing. It receives the arrays of a graph and
returns the refined poses, each as a pickle through a pipe.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import check_type
from bundle.inertial.two_loops.closure_loop import solved_on_one_thread
from bundle.model.pose_graph_arrays import PoseGraph

Array = NDArray[np.float64]

_FIELDS = ("poses", "edges", "measurements", "information", "fixed")
_NICE = 10


class ProcessSolver:
    """Solver for a :class:`ClosureLoop`; calls return the refined poses of a graph.

    The constructor returns once the process is ready. ``close`` or the end of the program ends it.

    Raises:
        RuntimeError: the process ended, or its solve failed; the message has the reason.
    """

    command = "from bundle.inertial.two_loops.process_solver import serve; serve()"

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", self.command], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._receive()

    def __call__(self, graph: PoseGraph) -> Array:
        """Return the refined poses (n, 7) of a solve on one thread."""
        check_type("ProcessSolver: graph", graph, PoseGraph)
        assert self._process.stdin is not None
        try:
            pickle.dump({name: getattr(graph, name) for name in _FIELDS}, self._process.stdin, 5)
            self._process.stdin.flush()
        except OSError:
            raise RuntimeError(self._end()) from None
        answer = self._receive()
        if isinstance(answer, str):
            raise RuntimeError(f"solve in another process: {answer}")
        poses: Array = answer
        return poses

    def close(self) -> None:
        """End the process and any solve in it."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None and not pipe.closed:
                try:
                    pipe.close()
                except OSError:  # data not yet sent to it
                    continue

    def _receive(self) -> Any:
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):
            raise RuntimeError(self._end()) from None

    def _end(self) -> str:
        return f"the solver's process ended with exit code {self._process.wait()}"


def serve(solver: Callable[[PoseGraph], Array] | None = None) -> None:
    """Solve graphs from standard input until it ends; for :class:`ProcessSolver`."""
    solver = solver or solved_on_one_thread
    if hasattr(os, "nice"):
        os.nice(_NICE)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries' prints must not mix with answers
    given = sys.stdin.buffer
    answer: Any = None
    while True:
        pickle.dump(answer, answers, 5)
        answers.flush()
        try:
            fields = pickle.load(given)
        except (EOFError, KeyboardInterrupt):
            return
        try:
            answer = np.array(solver(PoseGraph(**fields)))
        except KeyboardInterrupt:
            return
        except Exception as error:  # the caller reports it in its own process
            answer = f"{type(error).__name__}: {error}"
