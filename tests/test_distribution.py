"""What the installed distribution says of itself, and what a wheel with libraries has to say."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))
import wheel_licences  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_distribution_is_not_named_like_the_one_of_others_on_pypi() -> None:
    assert PROJECT["name"] == "bundle-adjust"
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "python").rglob("*.py")]
    wrong = ("pip install bundle\n", "pip install bundle[", "pip install bundle ")
    assert not [page for page in pages if any(text in page.read_text() for text in wrong)]


def test_own_licence_files_are_there_and_match_the_expression() -> None:
    texts = [(ROOT / name).read_text() for name in PROJECT["license-files"]]
    assert PROJECT["license"] == wheel_licences.OWN == "BSD-3-Clause AND MIT"
    assert "BSD 3-Clause" in texts[0]
    assert "MIT License" in texts[1]


def test_expression_names_each_term_once_and_no_plain_gpl() -> None:
    terms = wheel_licences.expression(list(wheel_licences.LIBRARIES)).split(" AND ")
    assert len(terms) == len(set(terms))
    assert {"LGPL-2.1-or-later", "MPL-2.0", "Apache-2.0"} <= set(terms)
    gpl = [term for term in terms if term.startswith("GPL")]
    assert gpl == ["GPL-3.0-or-later WITH GCC-exception-3.1"]


def test_a_library_of_unknown_licence_ends_it() -> None:
    with pytest.raises(SystemExit, match="libspqr"):
        wheel_licences.expression(["libcholmod", "libspqr"])


def test_metadata_gets_the_expression_and_the_files() -> None:
    before = "Name: x\nLicense-Expression: MIT\nLicense-File: LICENSE\n"
    after = wheel_licences.rewrite_metadata(before, "MIT AND MPL-2.0", ["a.txt", "b/c.txt"])
    assert after == (
        "Name: x\nLicense-Expression: MIT AND MPL-2.0\nLicense-File: a.txt\n"
        "License-File: b/c.txt\nLicense-File: LICENSE\n"
    )
