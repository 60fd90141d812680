"""Runs many small jobs in child processes that may crash, hang or print."""

from __future__ import annotations

import collections
import faulthandler
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GIGABYTE = 2**30
# A corrupt count must not become an allocation: beyond this, the process fails visibly.
ADDRESS_SPACE = 6 * GIGABYTE


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job: "ok" and "refused" are orderly, with a word on the kind."""

    job: str
    kind: str
    detail: str

    @property
    def orderly(self) -> bool:
        """True if the outcome is orderly."""
        return self.kind in ("ok", "refused")


def run(function: str, jobs: Sequence[str], *, timeout: float = 60.0, batch: int = 100):
    """Call `function` ("module:name") with each job in child processes, `batch` jobs in each.

    It returns a word, or raises; bundle.InputError and OSError with one line are refusals. A job on
    which the process dies, hangs beyond `timeout` seconds, or prints is reported as such.
    """
    outcomes: list[Outcome] = []
    while len(outcomes) < len(jobs):
        outcomes += _run_batch(function, jobs[len(outcomes) : len(outcomes) + batch], timeout)
    return outcomes


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return counts per kind and detail, and every disorderly job."""
    counts = collections.Counter(
        (outcome.kind, outcome.detail if outcome.kind == "ok" else "") for outcome in outcomes
    )
    lines = [f"{count:6d}  {kind} {detail}" for (kind, detail), count in sorted(counts.items())]
    wrong = [outcome for outcome in outcomes if not outcome.orderly]
    lines += [f"WRONG {outcome.job}: {outcome.kind}: {outcome.detail[:2000]}" for outcome in wrong]
    return "\n".join([*lines, f"{len(outcomes)} jobs, {len(wrong)} wrong"])


def _run_batch(function: str, jobs: Sequence[str], timeout: float) -> list[Outcome]:
    child = subprocess.run(
        [sys.executable, "-m", __name__, function, str(timeout)],
        input="".join(json.dumps(job) + "\n" for job in jobs),
        capture_output=True,
        text=True,
        errors="backslashreplace",
        cwd=ROOT,
        check=False,
    )
    verdicts = [json.loads(line) for line in child.stdout.splitlines()]
    outcomes = [Outcome(job, *verdict) for job, verdict in zip(jobs, verdicts, strict=False)]
    if len(outcomes) < len(jobs):
        died = f"exit status {child.returncode}: {child.stderr}"
        outcomes.append(Outcome(jobs[len(outcomes)], "died", died))
    return outcomes


def _attempt(call, job: str) -> tuple[str, str]:
    import bundle
    from bundle.io.atomic.replaced_paths import NoteWarning

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", NoteWarning)
            return "ok", str(call(job))
    except (bundle.InputError, OSError) as error:
        text = str(error)
        one_line = bool(text.strip()) and len(text.splitlines()) == 1 and len(text) < 1000
        return ("refused" if one_line else "bad message"), text
    except AssertionError as error:
        return "nonsense", str(error)
    except BaseException as error:
        return type(error).__name__, str(error)


def _child() -> None:
    function, timeout = sys.argv[1], float(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    verdicts = os.fdopen(os.dup(1), "w")
    crashes = os.fdopen(os.dup(2), "w")
    faulthandler.enable(crashes)
    module, _, name = function.partition(":")
    call = getattr(importlib.import_module(module), name)
    with tempfile.TemporaryFile() as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        for line in sys.stdin:
            faulthandler.dump_traceback_later(timeout, exit=True, file=crashes)
            kind, detail = _attempt(call, json.loads(line))
            faulthandler.cancel_dump_traceback_later()
            sys.stdout.flush()
            sys.stderr.flush()
            printed.seek(0)
            if stray := printed.read():
                kind, detail = "printed", stray.decode(errors="backslashreplace")
                printed.seek(0)
                printed.truncate()
            print(json.dumps([kind, detail]), file=verdicts, flush=True)


if __name__ == "__main__":
    _child()
