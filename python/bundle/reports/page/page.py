"""One HTML file that needs nothing else: no network, no second file, no script from elsewhere."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.special_paths import is_stream
from bundle.io.file_names import PAGE, check_name

__all__ = ["as_json", "asset", "tag", "write_page"]

# What the page may load: what stands in it. A browser holds it to that, whatever is in the data.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
VOID = {"img", "input", "meta"}


def tag(name: str, /, *children: str, **attributes: Any) -> str:
    """Return an element. Children are markup as it is, values of attributes are escaped.

    An attribute of None or False is left out, one of True has no value; ``class_`` is ``class``,
    other underscores are hyphens.
    """
    words = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        shown = key.rstrip("_").replace("_", "-")
        words.append(shown if value is True else f'{shown}="{escape(str(value))}"')
    opening = f"<{' '.join(words)}>"
    return opening if name in VOID else f"{opening}{''.join(children)}</{name}>"


def as_json(data: Any) -> str:
    """Return data as JSON that may stand in a script element, whatever names it holds.

    The parser of HTML ends a script at ``</script``, so that no ``<`` may stand in it; ``&`` and
    ``>`` go with it. Numbers that are not finite are null.
    """
    text = json.dumps(_finite(data), allow_nan=False, separators=(",", ":"))
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
    style: str = "",
) -> None:
    """Write a page that appears whole or not at all.

    Args:
        path: of the HTML file.
        title: of the page, as text.
        sections: markup.
        data: what its script needs; a page without is one without script.
        headline: at the top of the page, as text; the title where there is none.
        script: a module that reads the data in place of the player of eliminations; "" for none.
        style: rules beside those of every page.

    Raises:
        InputError: the path is a folder, its parent is none, or its name says another format.
        OSError: the file cannot be written.
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
        tag("style", asset("page.css"), style),
    ]
    body = tag("body", tag("h1", escape(headline or title)), *sections, scripts)
    page = tag("html", tag("head", *head), body, lang="en")
    atomic.write_text(path, f"<!doctype html>\n{page}\n")


def asset(*name: str) -> str:
    """Return the text of a file in the folder of assets."""
    return resources.files("bundle.reports.page").joinpath("assets", *name).read_text("utf-8")


def _finite(data: Any) -> Any:
    """Return data with null for what JSON has no number for."""
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return data
