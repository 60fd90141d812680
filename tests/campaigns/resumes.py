"""Kills of `bundle refine --checkpoint` at random: the resumed run ends as if never killed.

python -m tests.campaigns.resumes COUNT [SEED]

Each run is killed, resumed, killed again and so on until one gets to its end; its model must then
be that of the run that was not killed, byte for byte. Between two kills whatever stands at the
checkpoint's path is a whole checkpoint. Kills hit random instants from the start of the command to
its end, and half of the time the moment of a checkpoint: an operation on the file system.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import bundle

# What `refine` imports, once here and not in every child.
import bundle.cli.refine
import bundle.reports.terminal.refine
import bundle.solving.rounds
from bundle.cli.main import main
from bundle.model.problem import Problem
from bundle.solving.rounds import checkpoint
from tests.io.kills import killed_before
from tests.scenes import make_problem

FLAGS = [
    *("--rounds", "4", "--max-error", "1.2", "--loss", "cauchy", "--function-tolerance", "1e-10"),
    *("--threads", "1", "--deterministic", "--quiet", "--checkpoint-interval", "2"),
]


@dataclass
class Outcome:
    """Counts and failures."""

    kills: int = 0
    runs: int = 0
    with_checkpoint: int = 0
    wrong: list[str] = field(default_factory=list)


def make_scene(num_points: int = 150) -> Problem:
    """A scene with outliers of many sizes, for several rounds."""
    problem = make_problem(num_images=8, num_points=num_points, model="PINHOLE", shared=True)
    rng = np.random.default_rng(0)
    size = np.exp(rng.uniform(np.log(4), np.log(60), problem.num_observations))
    size *= rng.random(problem.num_observations) < 0.05
    xy = problem.observation_xy + size[:, None] * rng.choice([-1, 1], (len(size), 2))
    return problem.replace(observation_xy=xy)


def campaign(count: int, seed: int = 0, num_points: int = 150) -> Outcome:
    """Kill `count` times."""
    draw = random.Random(seed)
    outcome = Outcome()
    with tempfile.TemporaryDirectory(prefix="resumes-") as name:
        folder = Path(name)
        bundle.save(make_scene(num_points), folder / "input")
        started = time.perf_counter()
        assert not killed_before(-1, lambda: _refine(folder, "reference", "--checkpoint"))
        seconds = time.perf_counter() - started
        expected = files_of(folder / "reference")
        operations = _count_operations(folder)
        while outcome.kills < count:
            (folder / "run.ckpt").unlink(missing_ok=True)
            flag = "--checkpoint"
            while True:
                if draw.random() < 0.5:
                    at = draw.randrange(operations)
                    killed = killed_before(at, lambda flag=flag: _refine(folder, "out", flag))
                else:
                    killed = _killed_after(draw.uniform(0, seconds), folder, flag)
                if not killed:
                    break
                outcome.kills += 1
                outcome.with_checkpoint += is_whole(folder / "run.ckpt", outcome)
                flag = "--resume"
            outcome.runs += 1
            if files_of(folder / "out") != expected:
                outcome.wrong.append(f"run {outcome.runs} ended elsewhere")
    return outcome


def _refine(folder: Path, output: str, flag: str) -> None:
    """Refine in silence; the checkpoint of the reference is of its own."""
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (1, 2):
        os.dup2(null, descriptor)
    file = folder / ("reference.ckpt" if output == "reference" else "run.ckpt")
    arguments = ["refine", str(folder / "input"), "-o", f"{folder / output}/", *FLAGS]
    if main([*arguments, flag, str(file)]) != 0:
        raise AssertionError("refine has failed")


def _count_operations(folder: Path) -> int:
    """Return how many operations on the file system a run has, to within a factor of two."""
    count = 1
    while killed_before(count, lambda: _refine(folder, "counted", "--checkpoint")):
        count *= 2
    (folder / "run.ckpt").unlink(missing_ok=True)
    return count


def _killed_after(seconds: float, folder: Path, flag: str) -> bool:
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        try:
            _refine(folder, "out", flag)
            os._exit(0)
        finally:
            os._exit(1)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, "the run has failed"
    return os.WIFSIGNALED(status)


def is_whole(path: Path, outcome: Outcome) -> bool:
    """Tell whether a checkpoint stands there; note one that is not whole."""
    if not path.exists():
        return False
    try:
        checkpoint.Checkpoint(path, {}, 1)
    except bundle.InputError as error:
        outcome.wrong.append(str(error))
    return True


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


if __name__ == "__main__":
    result = campaign(int(sys.argv[1]), *map(int, sys.argv[2:]))
    print(result)
    sys.exit(bool(result.wrong))
