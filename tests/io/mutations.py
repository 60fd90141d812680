"""Seeded corruption of files, and a check that loading them ends in an orderly way.

A mutated file may load (the damage can be harmless) or be refused with ``InputError`` or
``OSError`` and a message of one line. Anything else, a crash, a hang, a traceback, output, is a
defect.
"""

import json
import os
import random
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

DRIVER = Path(__file__).with_name("load_driver.py")

UGLY_TOKENS = (
    b"nan",
    b"-nan",
    b"NaN",
    b"inf",
    b"-inf",
    b"1e999",
    b"-1e999",
    b"1e-999",
    b"0",
    b"-0",
    b"-1",
    b"2147483647",
    b"2147483648",
    b"4294967296",
    b"-9223372036854775808",
    b"18446744073709551616",
    b"99999999999999999999999999",
    b"1.5",
    b"1e5",
    b"0x10",
    b"1,5",
    b"--1",
    b"+",
    b"1e",
    b"#",
    b"\xff\xfe",
    b"\x00",
    b"7" * 5000,
    b"A" * 5000,
)


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data)
    damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def set_byte(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data)
    damaged[rng.randrange(len(data))] = rng.choice((0, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return bytes(damaged)


def delete_bytes(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data))
    return data[:start] + data[start + rng.choice((1, 1, 4, 8, 100)) :]


def insert_bytes(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + rng.randbytes(rng.choice((1, 1, 4, 8, 100))) + data[start:]


def duplicate_bytes(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data))
    stop = min(len(data), start + rng.choice((1, 8, 64, 1024)))
    return data[:stop] + data[start:]


def truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def overwrite_word(data: bytes, rng: random.Random) -> bytes:
    """Put an extreme value where a binary format may keep a count, an id or a double."""
    word = rng.choice(
        (
            b"\xff" * 4,
            b"\xff" * 8,
            b"\x00" * 8,
            (2**31 - 1).to_bytes(4, "little"),
            (2**31).to_bytes(4, "little"),
            (2**62).to_bytes(8, "little"),
            (0x7FF0000000000000).to_bytes(8, "little"),  # infinity
            (0x7FF8000000000000).to_bytes(8, "little"),  # NaN
        )
    )
    start = rng.randrange(max(1, len(data) - len(word)))
    return data[:start] + word + data[start + len(word) :]


def _tokens(data: bytes) -> list[re.Match[bytes]]:
    return list(re.finditer(rb"\S+", data))


def replace_token(data: bytes, rng: random.Random) -> bytes:
    token = rng.choice(_tokens(data))
    return data[: token.start()] + rng.choice(UGLY_TOKENS) + data[token.end() :]


def negate_token(data: bytes, rng: random.Random) -> bytes:
    token = rng.choice(_tokens(data))
    return data[: token.start()] + b"-" + data[token.start() :]


def delete_token(data: bytes, rng: random.Random) -> bytes:
    token = rng.choice(_tokens(data))
    return data[: token.start()] + data[token.end() :]


def duplicate_token(data: bytes, rng: random.Random) -> bytes:
    token = rng.choice(_tokens(data))
    return data[: token.end()] + b" " + token.group() + data[token.end() :]


def swap_tokens(data: bytes, rng: random.Random) -> bytes:
    first, second = sorted(rng.sample(_tokens(data), 2), key=lambda token: token.start())
    between = data[first.end() : second.start()]
    return data[: first.start()] + second.group() + between + first.group() + data[second.end() :]


def delete_line(data: bytes, rng: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    del lines[rng.randrange(len(lines))]
    return b"".join(lines)


def duplicate_line(data: bytes, rng: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    index = rng.randrange(len(lines))
    return b"".join([*lines[: index + 1], lines[index], *lines[index + 1 :]])


Mutator = Callable[[bytes, random.Random], bytes]

BYTE_MUTATORS: tuple[Mutator, ...] = (
    flip_bit,
    set_byte,
    delete_bytes,
    insert_bytes,
    duplicate_bytes,
    truncate,
    overwrite_word,
)
TOKEN_MUTATORS: tuple[Mutator, ...] = (
    replace_token,
    replace_token,
    negate_token,
    delete_token,
    duplicate_token,
    swap_tokens,
    delete_line,
    duplicate_line,
)


def mutate(
    data: bytes, mutators: Sequence[Mutator], count: int, seed: int
) -> Iterator[tuple[str, bytes]]:
    """Yield `count` pairs of a name that tells what was done and the damaged bytes.

    The mutators take turns, so that each is used; the same seed gives the same damage.
    """
    rng = random.Random(seed)
    for index in range(count):
        mutator = mutators[index % len(mutators)]
        yield f"{index:04d}-{mutator.__name__}", mutator(data, rng)


@dataclass(frozen=True)
class Outcome:
    """Outcome of loading one path."""

    path: Path
    kind: str  # "loaded", "InputError", "OSError"; or what went wrong
    message: str

    @property
    def orderly(self) -> bool:
        if self.kind == "loaded":
            return True
        one_line = bool(self.message.strip()) and len(self.message.splitlines()) == 1
        return self.kind in ("InputError", "OSError") and one_line and len(self.message) < 1000


def load_all(paths: Sequence[Path], *, timeout: float = 20.0, batch: int = 200) -> list[Outcome]:
    """Load every path by ``bundle.load`` in subprocesses, `batch` files in each.

    `timeout` is in seconds per file. A path on which the process dies or hangs is reported as such
    and the files after it go to a fresh process.
    """
    outcomes: list[Outcome] = []
    while len(outcomes) < len(paths):
        outcomes += _load_batch(paths[len(outcomes) : len(outcomes) + batch], timeout)
    return outcomes


def _load_batch(paths: Sequence[Path], timeout: float) -> list[Outcome]:
    """Load paths in one process, up to and including the first that brings it down."""
    driver = subprocess.run(
        [sys.executable, str(DRIVER), str(timeout)],
        input=b"".join(os.fsencode(path) + b"\0" for path in paths),
        capture_output=True,
        check=False,
    )
    verdicts = [json.loads(line) for line in driver.stdout.splitlines()]
    outcomes = [Outcome(path, *verdict) for path, verdict in zip(paths, verdicts, strict=False)]
    if len(outcomes) < len(paths):
        crash = driver.stderr.decode(errors="backslashreplace")
        died = Outcome(paths[len(outcomes)], "died", f"exit status {driver.returncode}: {crash}")
        outcomes.append(died)
    return outcomes
