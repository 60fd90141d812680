"""Pages read back by Python's own parser of HTML."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

VOID = {"area", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}
LOADING = {"src", "href", "srcset", "data", "action", "poster", "background"}


class Page(HTMLParser):
    """Contents of a page: texts by element, what it would load; mismatched tags fail."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text("utf-8")
        self.open: list[str] = []
        self.scripts: list[str] = []
        self.words: list[str] = []
        self.loads: list[str] = []
        self.rows: list[list[str]] = []
        self.ids: list[str] = []
        self.feed(self.source)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in LOADING and value is not None:
                self.loads.append(value)
            if name == "id" and value is not None:
                self.ids.append(value)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside == "script":
            self.scripts[-1] += data
        elif inside != "style":
            self.words.append(data)
        if inside in ("td", "th"):
            self.rows[-1][-1] += data

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def check_self_contained(page: Page) -> None:
    """Nothing is loaded but what stands in the page."""
    inside = {address for address in page.loads if address.startswith("#")}
    assert {address[1:] for address in inside} <= set(page.ids)
    others = set(page.loads) - inside
    assert all(address.startswith("data:image/png;base64,") for address in others)
    without_namespace = page.source.replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"(https?:|@import|url\()", without_namespace)
    assert "default-src &#x27;none&#x27;" in page.source
    assert len(page.ids) == len(set(page.ids))
