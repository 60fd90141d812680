"""Corrupted BAL files load or are refused in one line: no crash, hang, output or memory bomb."""

import bz2
from pathlib import Path

import pytest

from tests.io.bal_files import bal_text, gzip_bytes, make_bal
from tests.io.mutations import BYTE_MUTATORS, TOKEN_MUTATORS, Outcome, load_all, mutate


def head_of(text: bytes, num_cameras: int, num_points: int) -> bytes:
    """Cut a BAL problem down to its first cameras and points."""
    tokens = text.split()
    all_cameras, all_points, count = (int(token) for token in tokens[:3])
    kept = [
        tokens[3 + 4 * i : 7 + 4 * i]
        for i in range(count)
        if int(tokens[3 + 4 * i]) < num_cameras and int(tokens[4 + 4 * i]) < num_points
    ]
    cameras = tokens[3 + 4 * count :][: 9 * num_cameras]
    points = tokens[3 + 4 * count + 9 * all_cameras :][: 3 * num_points]
    assert len(points) == 3 * min(num_points, all_points)
    header = b"%d %d %d" % (num_cameras, num_points, len(kept))
    return b"\n".join([header, *(b" ".join(row) for row in kept), *cameras, *points, b""])


def load_mutants(
    folder: Path, data: bytes, mutators, count: int, seed: int, wrap=bytes
) -> list[Outcome]:
    paths = []
    for name, mutant in mutate(data, mutators, count, seed):
        paths.append(folder / name)
        paths[-1].write_bytes(wrap(mutant))
    intact = folder / "intact"
    intact.write_bytes(wrap(data))
    outcomes = load_all([intact, *paths])
    assert outcomes[0].kind == "loaded"
    return outcomes[1:]


def check(outcomes: list[Outcome]) -> None:
    assert [outcome for outcome in outcomes if not outcome.orderly] == []
    refused = [outcome for outcome in outcomes if outcome.kind == "InputError"]
    assert len(refused) > len(outcomes) // 4, "the damage does not reach the reader"
    assert all(outcome.message.startswith(str(outcome.path) + ":") for outcome in refused)


@pytest.mark.parametrize(("mutators", "seed"), [(BYTE_MUTATORS, 1), (TOKEN_MUTATORS, 2)])
def test_small_file(tmp_path: Path, mutators, seed: int) -> None:
    check(load_mutants(tmp_path, bal_text(*make_bal(20)), mutators, 160, seed))


@pytest.mark.parametrize("compress", [gzip_bytes, bz2.compress])
def test_compressed_file(tmp_path: Path, compress) -> None:
    """Damage to the file as stored."""
    data = compress(bal_text(*make_bal(21, num_points=40)))
    check(load_mutants(tmp_path, data, BYTE_MUTATORS, 120, 3))


@pytest.mark.parametrize("wrap", [gzip_bytes, bz2.compress])
def test_content_of_a_compressed_file(tmp_path: Path, wrap) -> None:
    check(load_mutants(tmp_path, bal_text(*make_bal(22)), TOKEN_MUTATORS, 60, 4, wrap))


@pytest.mark.parametrize(("mutators", "seed"), [(BYTE_MUTATORS, 5), (TOKEN_MUTATORS, 6)])
def test_head_of_a_real_file(bundle_data: Path, tmp_path: Path, mutators, seed: int) -> None:
    stored = (bundle_data / "bal" / "problem-49-7776-pre.txt.bz2").read_bytes()
    check(load_mutants(tmp_path, head_of(bz2.decompress(stored), 8, 60), mutators, 80, seed))
