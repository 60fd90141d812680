"""Kills of `bundle refine` over what it reads: afterwards the old or the new stands there, whole.

python -m tests.campaigns.kills COUNT [SEED]

Half of the kills hit each operation on the file system in turn, half hit random instants, from the
start of the command to its end. The cases are a COLMAP model in binary, one in text, a BAL file,
and the two models once more on a system that cannot exchange folders. There the next command that
loads the model may have to finish the replacement; in all other cases what stands there must be
whole without it, files beside the model included.
"""

from __future__ import annotations

import dataclasses
import os
import random
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pycolmap

import bundle

# What `refine` imports, once here and not in every child.
import bundle.cli.refine
import bundle.reports.terminal.refine
from bundle.cli.main import main
from bundle.io.atomic import replacement
from bundle.io.atomic.replaced_paths import MODEL_FILES
from bundle.io.atomic.temporary import is_temporary
from tests.io.kills import killed_before
from tests.scenes import make_problem, scene

BESIDE = {"project.ini": b"ini", "images/left/a.jpg": b"jpg"}

Files = dict[str, bytes]


@dataclass
class Case:
    """A model that is refined in place, and the outcomes so far."""

    name: str
    path: Path
    can_exchange: bool = True
    old: Files = field(default_factory=dict)
    new: Files = field(default_factory=dict)
    seconds: float = 0.0
    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(
            ("operations", "instants", "old", "new", "recovered", "leftovers"), 0
        )
    )
    wrong: list[str] = field(default_factory=list)

    def restore(self) -> None:
        """Put the old model back; leftovers of killed runs stay for the next one."""
        if self.path.is_dir():
            for name in MODEL_FILES:
                (self.path / name).unlink(missing_ok=True)
        for name, content in self.old.items():
            target = self.path / name if name else self.path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)

    def found(self) -> Files:
        """Return what stands there, without temporaries."""
        if self.path.is_file():
            return {"": self.path.read_bytes()}
        files = (path for path in sorted(self.path.rglob("*")) if path.is_file())
        names = {path: path.relative_to(self.path) for path in files}
        return {
            str(name): path.read_bytes()
            for path, name in names.items()
            if not any(map(is_temporary, name.parts))
        }

    def leftovers(self) -> bool:
        """Tell whether a killed run has left a temporary behind."""
        folders = {self.path.parent, self.path} if self.path.is_dir() else {self.path.parent}
        return any(is_temporary(child.name) for folder in folders for child in folder.iterdir())

    def refine(self) -> None:
        """Refine in place, in silence."""
        null = os.open(os.devnull, os.O_RDWR)
        for descriptor in (1, 2):
            os.dup2(null, descriptor)
        arguments = ["refine", str(self.path), "-o", str(self.path), "--threads", "1", "--quiet"]
        if main([*arguments, "--max-iterations", "3"]) > 1:
            raise AssertionError("refine has failed")


def campaign(count: int, seed: int = 0, num_points: int = 200) -> list[Case]:
    """Kill `count` times; return the cases with what was counted and what was wrong."""
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        cases = _cases(Path(folder), num_points)
        for index, case in enumerate(cases):
            with _system(case):
                _kill(case, count // len(cases) + (index < count % len(cases)), draw)
    return cases


def _cases(folder: Path, num_points: int) -> list[Case]:
    problem = make_problem(num_images=6, num_points=num_points)
    formats = {"binary": "colmap", "text": "colmap-text"}
    cases = []
    for can_exchange in (True, False):
        for name, format in formats.items():
            label = name if can_exchange else f"{name}, one by one"
            case = Case(label, folder / label.replace(", ", "-") / "model", can_exchange)
            case.path.parent.mkdir()
            bundle.save(problem, case.path, format)
            for beside, content in BESIDE.items():
                (case.path / beside).parent.mkdir(parents=True, exist_ok=True)
                (case.path / beside).write_bytes(content)
            cases.append(case)
    bal = Case("BAL", folder / "bal" / "problem.txt")
    bal.path.parent.mkdir()
    bundle.save(scene(6, num_points), bal.path)
    cases.insert(2, bal)
    for case in cases:
        with _system(case):
            _measure(case)
    return cases


def _measure(case: Case) -> None:
    """Find out what the case becomes, and how long that takes."""
    case.old = case.found()
    started = time.perf_counter()
    assert not killed_before(-1, case.refine)
    case.seconds = time.perf_counter() - started
    case.new = case.found()
    assert set(BESIDE) <= set(case.new) or not case.path.is_dir()
    assert case.new != case.old
    case.restore()
    assert case.found() == case.old


@contextmanager
def _system(case: Case) -> Iterator[None]:
    """Take the exchange of folders from the system where the case is to go without."""
    real = replacement._exchange

    def refuse(*_: object) -> None:
        raise OSError(22, "Invalid argument")

    replacement._exchange = real if case.can_exchange else refuse
    try:
        yield
    finally:
        replacement._exchange = real


def _kill(case: Case, count: int, draw: random.Random) -> None:
    operation = kills = 0
    while kills < count:
        if kills % 2 == 0:
            kind = "operations"
            killed = killed_before(operation, case.refine)
            operation = operation + 1 if killed else 0
        else:
            kind = "instants"
            killed = _killed_after(draw.uniform(0, case.seconds), case)
        if killed:
            kills += 1
            case.counts[kind] += 1
            _judge(case, f"{kind}, kill {kills}, operation {operation}")
        case.restore()
    assert not killed_before(-1, case.refine)
    if case.leftovers():
        case.wrong.append("the last run has not removed the leftovers")


def _killed_after(seconds: float, case: Case) -> bool:
    child = os.fork()
    if child == 0:
        try:
            case.refine()
        finally:
            os._exit(0)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def _judge(case: Case, what: str) -> None:
    case.counts["leftovers"] += case.leftovers()
    before = case.found()
    if case.can_exchange:
        _require(case, before in (case.old, case.new), f"{what}: a mixture")
        if case.path.is_dir():
            try:
                pycolmap.Reconstruction(case.path)
            except (ValueError, RuntimeError) as error:
                case.wrong.append(f"{what}: COLMAP cannot load it: {error}")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            bundle.load(case.path)
        except (bundle.InputError, OSError) as error:
            case.wrong.append(f"{what}: cannot be loaded: {error}")
    after = case.found()
    _require(case, after in (case.old, case.new), f"{what}: a mixture after loading")
    _require(case, before == after or len(said) == 1, f"{what}: recovered without a word")
    case.counts["new" if after == case.new else "old"] += 1
    case.counts["recovered"] += before != after


def _require(case: Case, condition: bool, otherwise: str) -> None:
    if not condition:
        case.wrong.append(otherwise)


def summarise(cases: list[Case]) -> str:
    """Return a table of the cases, and everything that was wrong."""
    heads = [*dataclasses.replace(cases[0]).counts, "wrong"]
    lines = [f"{'':20}" + "".join(f"{head:>12}" for head in heads)]
    for case in cases:
        numbers = [*case.counts.values(), len(case.wrong)]
        lines.append(f"{case.name:20}" + "".join(f"{number:12d}" for number in numbers))
    lines += [f"WRONG {case.name}: {text}" for case in cases for text in case.wrong]
    kills = sum(case.counts["operations"] + case.counts["instants"] for case in cases)
    return "\n".join([*lines, f"{kills} kills, {sum(len(case.wrong) for case in cases)} wrong"])


if __name__ == "__main__":
    result = campaign(*map(int, sys.argv[1:3]))
    print(summarise(result))
    sys.exit(any(case.wrong for case in result))
