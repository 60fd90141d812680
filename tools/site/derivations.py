"""The directive ``derivation``: what a source file derives, on a page of the site.

The text is the comments of the file itself, read while the site is built, so that page and code
cannot differ. A file gives its head (of Python: the docstring), then its comments of at least
``SHORTEST`` lines that begin in the first column, each under the declaration that it stands above.
Lines that are indented are formulas, all others are text.

A file of the core with a comment of ``LONG`` lines or more has to be on some page. A link to a file
that has a page leads to that page.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from docutils import nodes
from sphinx import addnodes
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
SHORTEST = 6
LONG = 16

logger = logging.getLogger(__name__)


class Comment(NamedTuple):
    """A comment of a source file."""

    line: int
    lines: list[str]
    stands_above: str
    """The declaration that follows, "" for the head of a file."""


def comments_of(path: Path) -> list[Comment]:
    """Return the comments of a file that derive something."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        docstring = ast.get_docstring(ast.parse(text)) or ""
        head = [Comment(1, docstring.splitlines(), "")] if docstring else []
        return [*head, *_comments(text.splitlines(), "#", code_seen=True)]
    return list(_comments(text.splitlines(), "//", code_seen=False))


def _comments(lines: list[str], sign: str, *, code_seen: bool) -> Iterator[Comment]:
    at = 0
    while at < len(lines):
        if not lines[at].startswith(sign):
            code_seen |= bool(lines[at].strip()) and not lines[at].startswith("#pragma")
            at += 1
            continue
        begin = at
        while at < len(lines) and lines[at].startswith(sign):
            at += 1
        following = lines[at] if at < len(lines) else ""
        head = not code_seen and not following.strip()
        if head or at - begin >= SHORTEST:
            text = [re.sub(rf"^{sign}/? ?", "", line) for line in lines[begin:at]]
            if sign == "#":  # the blank lines of the formatter stand between
                following = next(filter(None, lines[at:]), "")
            above = "" if head else following.rstrip(" {:;(,").strip()
            yield Comment(begin + 1, text, above)


def paragraphs(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield ("text" or "formula", content) of a comment, in order.

    A formula is a run of lines indented by two or more, blank lines between them included, or a
    table, whose lines begin with a bar. A list item ("- ", "1. ") begins a paragraph of its own;
    its further lines are text, as are further paragraphs that have the indent of its text.
    """
    blocks: list[tuple[str, list[str]]] = []
    in_item = False
    indent_of_items = 0
    for line in lines:
        blank = not line.strip()
        item = re.match(r"\s{0,3}(?:[-*]|\d+\.|\(\w\)) ", line)
        indent = len(line) - len(line.lstrip())
        indented = indent > 1 or line.startswith(("| ", "|-"))
        if blank:
            in_item = False
            if blocks:
                blocks[-1][1].append("")
            continue
        if item:
            in_item, indent_of_items = True, len(item[0])
        elif not indent:
            in_item, indent_of_items = False, 0
        is_text = in_item or not indented or indent == indent_of_items > 0
        kind = "text" if is_text else "formula"
        joins = blocks and blocks[-1][0] == kind and not item
        if joins and (kind == "formula" or blocks[-1][1][-1] != ""):
            blocks[-1][1].append(line)
        else:
            blocks.append((kind, [line]))
    for kind, content in blocks:
        while content and not content[-1]:
            content.pop()
        if kind == "text":
            yield kind, " ".join(line.strip() for line in content)
        else:
            margin = min(len(line) - len(line.lstrip()) for line in content if line)
            yield kind, "\n".join(line[margin:] for line in content)


def text_nodes(text: str) -> list[nodes.Node]:
    """Return text with its quoted code (one or two backticks) set as code."""
    found: list[nodes.Node] = []
    text = re.sub(r":[a-z]+:`~?", "`", text)  # roles: what is named is enough
    text = re.sub(r"::$", ":", text)
    for number, part in enumerate(re.split(r"``(.+?)``|`(.+?)`", text)):
        if part:
            found.append(nodes.Text(part) if number % 3 == 0 else nodes.literal(part, part))
    return found


class Derivation(SphinxDirective):
    """``{derivation} cpp/core/factors/loss.h``: a section with the comments of a source file."""

    required_arguments = 1
    option_spec = {"title": str}  # noqa: RUF012 (docutils reads the attribute of the class)

    def run(self) -> list[nodes.Node]:
        """Return the section."""
        name = self.arguments[0]
        path = ROOT / name
        if not path.is_file():
            raise self.error(f"derivation: expected a file of the repository, found {name}")
        comments = comments_of(path)
        if not comments:
            raise self.error(f"derivation: {name} has no comment that derives something")
        self.env.note_dependency(str(path))
        self.env.note_dependency(__file__)
        anchor = nodes.make_id(name)
        listed: dict[str, tuple[str, str]] = self.env.__dict__.setdefault("derivations", {})
        if listed.get(name, (self.env.docname,))[0] != self.env.docname:
            raise self.error(f"derivation: {name} is on the page {listed[name][0]} already")
        listed[name] = (self.env.docname, anchor)

        section = nodes.section(ids=[anchor], names=[nodes.fully_normalize_name(name)])
        section += nodes.title("", "", *text_nodes(self.options.get("title", path.name)))
        source = nodes.paragraph(classes=["derived-in"])
        source += addnodes.download_reference(
            "", "", nodes.literal(name, name), reftarget="/" + _from_docs(path), refdoc=""
        )
        section += source
        for comment in comments:
            if comment.stands_above:
                above = nodes.paragraph(classes=["stands-above"])
                above += nodes.literal(comment.stands_above, comment.stands_above)
                section += above
            for kind, content in paragraphs(comment.lines):
                if kind == "formula":
                    section += nodes.literal_block(content, content, language="text")
                else:
                    section += nodes.paragraph("", "", *text_nodes(content))
        self.state.document.note_explicit_target(section)
        return [section]


def _from_docs(path: Path) -> str:
    return "../" + path.relative_to(ROOT).as_posix()


def _lead_to_pages(app: Any, doctree: nodes.document, docname: str) -> None:
    """Replace links to source files by links to the pages of their derivations."""
    listed = getattr(app.env, "derivations", {})
    for link in list(doctree.findall(addnodes.download_reference)):
        name = link["reftarget"].rpartition("../")[2]
        if name not in listed or "derived-in" in link.parent.get("classes", []):
            continue
        page, anchor = listed[name]
        uri = app.builder.get_relative_uri(docname, page)
        link.replace_self(
            nodes.reference("", "", *link.children, internal=True, refuri=f"{uri}#{anchor}")
        )


def _all_are_listed(app: Any, env: Any) -> None:
    for path in sorted((ROOT / "cpp" / "core").rglob("*.*")):
        name = path.relative_to(ROOT).as_posix()
        if path.suffix not in {".h", ".cpp"} or name in getattr(env, "derivations", {}):
            continue
        longest = max((len(comment.lines) for comment in comments_of(path)), default=0)
        if longest >= LONG:
            logger.warning("%s derives something (%d lines): name it in docs/theory", name, longest)


def _forget(app: Any, env: Any, docname: str) -> None:
    listed: dict[str, tuple[str, str]] = env.__dict__.setdefault("derivations", {})
    for name in [name for name, (page, _) in listed.items() if page == docname]:
        del listed[name]


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("derivation", Derivation)
    app.connect("env-purge-doc", _forget)
    app.connect("env-check-consistency", _all_are_listed)
    app.connect("doctree-resolved", _lead_to_pages)
    return {"version": "1", "parallel_read_safe": False, "parallel_write_safe": True}
