"""The row of a large problem, on a small one."""

import re

import pytest

from benchmarks import out_of_core, scale

PAGE = scale.ROOT / "docs" / "benchmarks.md"


def test_a_small_problem_makes_a_row(tmp_path):
    cells = scale.measure(3000, 2, tmp_path, keep=False)
    row = dict(zip(scale.HEADER, cells, strict=True))
    assert row["observations"] == "3,000"
    assert int(row["images"]) == scale.num_images(3000) == 10
    before, after = map(float, re.findall(r"[\d.]+", row["RMSE [px]"]))
    assert 0.5 < after < before
    assert float(row["bytes an observation"]) > 80
    assert list(tmp_path.iterdir()) == []


def test_too_small_a_disk_is_said_first(tmp_path, monkeypatch):
    monkeypatch.setattr(scale, "BYTES_ON_DISK", 1e18)
    with pytest.raises(RuntimeError, match="GB of disk"):
        scale.measure(3000, 2, tmp_path, keep=False)


def test_images_of_large_problems():
    sizes = [scale.num_images(int(n)) for n in (1000, 1e6, 20e6, 50e6, 250e6)]
    assert sizes == [10, 500, 10_000, 10_000, 25_000]


def test_kept_rows_are_of_this_table():
    parts = scale.measured().split("Out of core:")
    for part, titles in zip(parts, (scale.HEADER, out_of_core.HEADER), strict=True):
        lines = part.splitlines()
        (header,) = (line for line in lines if line.startswith("| observations"))
        assert header == "| " + " | ".join(titles) + " |"
        rows = [line for line in lines if line.startswith("| ") and line[2].isdigit()]
        assert rows
        assert all(line.count("|") == header.count("|") for line in rows)
    assert f"## Large problems, from file to file\n\n{scale.measured()}\n" in PAGE.read_text()
