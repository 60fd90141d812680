"""Pages of the site that are files outside of docs/, and links to what lies there.

A page whose first line is ``<!-- shows ../README.md -->`` has the text of that file. Links of every
page are written as on GitHub, from the folder of the file that they stand in. A link to a file that
a page shows becomes one to that page; a folder has no page, so that its name stays without a link;
Sphinx copies other files into the site.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SHOWS = re.compile(r"<!-- shows (\S+) -->\n")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s]+)\)")


def shown_file(page: Path) -> Path | None:
    """Return the file whose text a page shows, None for a page with a text of its own."""
    first = SHOWS.match(page.read_text(encoding="utf-8"))
    return (page.parent / first[1]).resolve() if first else None


def pages_that_show() -> dict[Path, Path]:
    """Return the pages by the files that they show."""
    found = {shown_file(page): page for page in DOCS.rglob("*.md")}
    return {path: page for path, page in found.items() if path is not None}


def relinked(text: str, source: Path, page: Path, shown: dict[Path, Path]) -> str:
    """Return a text of a source file with its links as they have to be on a page.

    Code blocks and addresses with a scheme stay as they are.
    """
    return "".join(
        line if in_code else LINK.sub(lambda link: _relinked(link, source, page, shown), line)
        for line, in_code in _lines(text)
    )


def _lines(text: str) -> Iterator[tuple[str, bool]]:
    fence = ""
    for line in text.splitlines(keepends=True):
        marks = re.match(r"\s*(```+|~~~+)", line)
        closes = marks is not None and marks[1] == fence
        yield line, bool(fence or marks)
        if closes:
            fence = ""
        elif marks and not fence:
            fence = marks[1]


def _relinked(link: re.Match[str], source: Path, page: Path, shown: dict[Path, Path]) -> str:
    image, text, address = link.groups()
    path, mark, anchor = address.partition("#")
    if not path or re.match(r"[a-z]+:", path):
        return link[0]
    target = (source.parent / path).resolve()
    if target.is_dir():
        return text if re.search("`", text) or image else f"`{text}`"
    target = shown.get(target, target)
    return f"{image}[{text}]({os.path.relpath(target, page.parent)}{mark}{anchor})"


def _read(app: Any, docname: str, content: list[str]) -> None:
    page = Path(app.env.doc2path(docname))
    if page.suffix != ".md":
        return
    source = shown_file(page) or page
    text = content[0]
    if source != page:
        app.env.note_dependency(str(source), docname=docname)
        text = source.read_text(encoding="utf-8")
    content[0] = relinked(text, source, page, pages_that_show())


def setup(app: Any) -> dict[str, Any]:
    """Rewrite each page when it is read."""
    app.connect("source-read", _read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
