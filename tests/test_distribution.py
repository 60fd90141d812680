"""What the distribution says of itself."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_distribution_is_not_named_like_the_one_of_others_on_pypi() -> None:
    assert PROJECT["name"] == "bundle-adjust"
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "python").rglob("*.py")]
    wrong = ("pip install bundle\n", "pip install bundle[", "pip install bundle ")
    assert not [page for page in pages if any(text in page.read_text() for text in wrong)]


def test_own_licence_files_match_the_expression() -> None:
    texts = [(ROOT / name).read_text() for name in PROJECT["license-files"]]
    assert PROJECT["license"] == "BSD-3-Clause AND MIT"
    assert "BSD 3-Clause" in texts[0]
    assert "MIT License" in texts[1]
