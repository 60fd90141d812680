"""Self-contained HTML file: no network, no second file, no external script."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.replaced_paths import is_stream
from bundle.io.recognition import PAGE, check_name
from bundle.reports.sections import plain

# The browser may load only content of the page itself; it enforces this for any data.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
VOID = {"img", "input", "meta"}


def tag(name: str, /, *children: str, **attributes: Any) -> str:
    """Return an element. Children are inserted unchanged as markup; attribute values are escaped.

    An attribute of None or False is omitted; an attribute of True has no value. ``class_`` becomes
    ``class``; underscores in other names become hyphens.
    """
    words = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        shown = key.rstrip("_").replace("_", "-")
        words.append(shown if value is True else f'{shown}="{escape(str(value))}"')
    opening = f"<{' '.join(words)}>"
    return opening if name in VOID else f"{opening}{''.join(children)}</{name}>"


def heading(title: str, name: str = "") -> str:
    """Return the heading of a section; the table of contents of the page links to it."""
    anchor = name or re.sub(r"\W+", "-", title.lower()).strip("-")
    return tag("h2", escape(title), id=anchor)


def lead(sentences: Sequence[str]) -> str:
    """Return the verdict of a page; its first sentence is bold."""
    first, *rest = map(escape, sentences)
    return tag("p", tag("strong", first), " ", " ".join(rest), class_="headline")


def command_box(command: str) -> str:
    """Return a command to copy; its lines break between words, and not after a hyphen."""
    words = " ".join(tag("span", escape(word)) for word in command.split(" "))
    return tag("pre", tag("code", words))


def as_json(data: Any) -> str:
    """Return data as JSON that is safe inside a script element, for all names in the data.

    HTML parsers end a script at ``</script``, so ``<`` is escaped, and ``&`` and ``>`` as well.
    Arrays and dataclasses become lists and objects, numbers that are not finite null.
    """
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def write_page(
    path: Path,
    title: str,
    sections: list[str],
    data: Mapping[str, Any] | None = None,
    *,
    headline: str = "",
    script: str | None = None,
) -> None:
    """Write a page completely, or leave no file if the write fails.

    Sections are markup; contents at the side list each :func:`heading`. Without data there is no
    script. ``script`` is a module that reads the data instead of the elimination player; "": none.
    """
    if not is_stream(path):
        check_name(path, *PAGE)
    scripts = ""
    if data is not None:
        scripts = tag("script", as_json(data), type="application/json", id="data")
        if script is None:
            scripts += tag("script", asset("elimination.js"))
        elif script:
            scripts += tag("script", script, type="module")
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", escape(title)),
        tag("style", asset("page.css")),
    ]
    body = [tag("h1", escape(headline or title)), _contents(sections), tag("main", *sections)]
    page = tag("html", tag("head", *head), tag("body", *body, scripts), lang="en")
    atomic.write_text(path, f"<!doctype html>\n{page}\n")


def _contents(sections: list[str]) -> str:
    found = re.findall(r'<h2 id="([^"]+)">([^<]+)</h2>', "".join(sections))
    items = [tag("li", tag("a", title, href=f"#{name}")) for name, title in found]
    return tag("nav", tag("ul", *items), aria_label="contents") if len(items) > 1 else ""


def asset(*name: str) -> str:
    """Return the text of a file in the assets folder."""
    return resources.files("bundle.reports.page").joinpath("assets", *name).read_text("utf-8")
