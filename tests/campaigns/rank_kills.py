"""Kills of single processes of `mpirun -n N bundle refine --checkpoint`: all end, a resume goes on.

python -m tests.campaigns.rank_kills COUNT [SEED] [N] [--slices]

A random process is killed at a random instant between the start of mpirun and its end. All must be
gone within ten seconds with one line of ours, no output may stand, and what stands at the
checkpoint's path must be whole. The run is resumed, killed again and so on, until one gets to its
end; its model must then be that of a run that was not killed, byte for byte. The runs have rounds,
for which the first process reads all; --slices: none, so that each process reads its slice.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bundle
from tests.campaigns.resumes import FLAGS, files_of, is_whole, make_scene
from tests.campaigns.resumes import Outcome as Resumed
from tests.solving.ranks.mpirun import mpirun_command

SECONDS_TO_END = 10.0
ROUNDS = ("--rounds", "4", "--max-error", "1.2")


@dataclass
class Outcome(Resumed):
    """Further counts of kills."""

    without_line: int = 0
    slowest_end: float = 0.0


def campaign(
    count: int,
    seed: int = 0,
    num_processes: int = 3,
    num_points: int = 150,
    *,
    in_slices: bool = False,
) -> Outcome:
    """Kill `count` times."""
    draw = random.Random(seed)
    flags = [flag for flag in FLAGS if flag not in ROUNDS] if in_slices else FLAGS
    outcome = Outcome()
    with tempfile.TemporaryDirectory(prefix="rank-kills-") as name:
        folder = Path(name)
        bundle.save(make_scene(num_points), folder / "input")
        begun = time.perf_counter()
        _, error = finish(start(folder, "reference", [*flags, "--checkpoint"], num_processes))
        assert error == "", error
        seconds = time.perf_counter() - begun
        expected = files_of(folder / "reference")
        while outcome.kills < count:
            (folder / "run.ckpt").unlink(missing_ok=True)
            flag = "--checkpoint"
            while _is_killed(draw, seconds, folder, [*flags, flag], num_processes, outcome):
                flag = "--resume"
            outcome.runs += 1
            if files_of(folder / "out") != expected:
                outcome.wrong.append(f"run {outcome.runs} ended elsewhere")
            for path in (folder / "out").iterdir():
                path.unlink()
            (folder / "out").rmdir()
    return outcome


def start(folder: Path, output: str, flags: list[str], num_processes: int) -> subprocess.Popen[str]:
    """Start a run; the checkpoint of the reference is of its own."""
    file = folder / ("reference.ckpt" if output == "reference" else "run.ckpt")
    words = ["refine", folder / "input", "-o", f"{folder / output}/", *flags, file]
    return subprocess.Popen(
        mpirun_command(num_processes, *words),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(run: subprocess.Popen[str]) -> tuple[int, str]:
    """Return the exit code of a run and what it said on standard error."""
    _, error = run.communicate(timeout=120)
    return run.returncode, error


def processes_of(run: subprocess.Popen[str]) -> list[int]:
    """Return the processes that mpirun has started, which has become prterun."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        if int(fields[1]) == run.pid and fields[0] not in "ZX":
            found.append(int(path.parent.name))
    return sorted(found)


def is_alive(pid: int) -> bool:
    """Tell whether a process is there, and more than its entry in the table."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def _is_killed(
    draw: random.Random, seconds: float, folder: Path, flags: list[str], num: int, outcome: Outcome
) -> bool:
    """Run, kill one at an instant, and judge; return False if the run had ended before."""
    run = start(folder, "out", flags, num)
    instant, which = draw.uniform(0, seconds), draw.randrange(num)
    time.sleep(instant)
    processes = processes_of(run)
    if len(processes) < num:  # mpirun has not begun, or has come to its end
        code, error = finish(run)
        _require(
            outcome, code == 0 and "error" not in error, f"not killed, but exit {code}: {error}"
        )
        return False
    try:
        os.kill(processes[which], signal.SIGKILL)
    except ProcessLookupError:
        finish(run)
        return False
    begun = time.monotonic()
    code, error = finish(run)
    if code == 0:  # the process had done its part
        return False
    left = processes
    while left and time.monotonic() - begun < SECONDS_TO_END:
        left = [pid for pid in left if is_alive(pid)]
        time.sleep(0.001)
    outcome.slowest_end = max(outcome.slowest_end, time.monotonic() - begun)
    outcome.kills += 1
    what = f"kill {outcome.kills} ({which} at {instant:.2f} s of {seconds:.2f} s)"
    _require(outcome, left == [], f"{what}: processes {left} are left")
    lines = [line for line in error.splitlines() if line.startswith("error: ")]
    _require(outcome, len(lines) <= 1, f"{what}: {lines}")
    outcome.without_line += lines == []
    _require(outcome, "Traceback" not in error, f"{what}: {error}")
    outcome.with_checkpoint += is_whole(folder / "run.ckpt", outcome)
    return not _is_complete(folder / "out", folder / "reference")


def _is_complete(found: Path, expected: Path) -> bool:
    """Tell whether the output stands already, as where a process dies after its work."""
    return found.exists() and files_of(found).keys() == files_of(expected).keys()


def _require(outcome: Outcome, condition: bool, otherwise: str) -> None:
    if not condition:
        outcome.wrong.append(otherwise)


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:] if word != "--slices"]
    result = campaign(*numbers, in_slices="--slices" in sys.argv)
    print(result)
    sys.exit(bool(result.wrong))
