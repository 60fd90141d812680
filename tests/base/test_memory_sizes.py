"""Sizes of memory as people write them."""

from __future__ import annotations

import pytest

from bundle.base.words import format_size, parse_size
from bundle.errors import InputError


@pytest.mark.parametrize(
    ("text", "size"),
    [("500MB", 500_000_000), ("2 GiB", 2**31), ("1.5kb", 1500), ("7", 7), (" 3 b ", 3)],
)
def test_sizes(text, size):
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "MB", "-1", "0", "5 parsecs", "1e9", "99999999999TB", "٣MB"])
def test_what_is_no_size(text):
    with pytest.raises(InputError, match="expected a size such as 500MB"):
        parse_size(text)


def test_sizes_are_told_in_three_digits():
    sizes = (0, 999, 1000, 999_600, 500e6, 19_234e6, 5e15)
    told = ["-", "999 B", "1 kB", "1 MB", "500 MB", "19.2 GB", "5000 TB"]
    assert [format_size(size) for size in sizes] == told
