"""Conversion of sources to pages: comments, links, names."""

import re
from pathlib import Path

import pytest

import bundle

pytest.importorskip("sphinx")
from docutils import nodes
from tools.site import derivations, mathml, repository_files

ROOT = Path(__file__).parents[2]

HEADER = """\
#pragma once

/// A title.
///
/// With a formula
///
///   S = U - W V^-1 W^T,
///
///   b = a  (a ~ 0)
///
/// where
/// - `V` is a block
///   of a point;
/// - U is not.
///
/// 1. A step
///    of two paragraphs,
///
///      x = 1,
///
///    ||x|| being small.
/// ||y|| is not.
///
/// | name | size |
/// |------|------|
/// | V    | 3    |
/// Last.

#include <cmath>

/// Short.
int Short();

/// One
/// two
/// three
/// four
/// five
/// six
struct Long {
  /// Inside, and therefore
  /// left
  /// out
  /// of
  /// the
  /// page.
  int x;
};
"""


def test_comments_of_a_header(tmp_path):
    path = tmp_path / "a.h"
    path.write_text(HEADER)
    head, above = derivations.comments_of(path)
    assert (head.line, head.stands_above, head.lines[0]) == (3, "", "A title.")
    assert (above.line, above.stands_above) == (34, "struct Long")
    assert above.lines == ["One", "two", "three", "four", "five", "six"]


def test_formulas_and_text_of_a_comment(tmp_path):
    path = tmp_path / "a.h"
    path.write_text(HEADER)
    assert list(derivations.paragraphs(derivations.comments_of(path)[0].lines)) == [
        ("text", "A title."),
        ("text", "With a formula"),
        ("formula", "S = U - W V^-1 W^T,\n\nb = a  (a ~ 0)"),
        ("text", "where"),
        ("text", "- `V` is a block of a point;"),
        ("text", "- U is not."),
        ("text", "1. A step of two paragraphs,"),
        ("formula", "x = 1,"),
        ("text", "||x|| being small. ||y|| is not."),
        ("formula", "| name | size |\n|------|------|\n| V    | 3    |"),
        ("text", "Last."),
    ]


def test_a_docstring_is_the_comment_of_a_module(tmp_path):
    path = tmp_path / "a.py"
    path.write_text('"""Title.\n\nText::\n\n    x = 1\n"""\n\n\ndef f():\n    """No."""\n')
    (comment,) = derivations.comments_of(path)
    assert list(derivations.paragraphs(comment.lines))[1:] == [
        ("text", "Text::"),
        ("formula", "x = 1"),
    ]
    path.write_text("x = 1\n")
    assert derivations.comments_of(path) == []


def test_comments_of_the_parts_of_a_module(tmp_path):
    path = tmp_path / "a.py"
    long = "".join(f"# {word}\n" for word in ("One", "two", "three", "four", "five", "six"))
    path.write_text(f'"""Title."""\n\n{long}\n\ndef f():\n    pass\n\n\n# Short.\nx = 1\n')
    head, part = derivations.comments_of(path)
    assert (head.lines, head.stands_above) == (["Title."], "")
    assert (part.line, part.stands_above, part.lines[5]) == (3, "def f()", "six")


def test_code_in_text_is_set_as_code():
    found = derivations.text_nodes("as :func:`bundle.solve` does with ``x[0]``::")
    assert [node.astext() for node in found] == ["as ", "bundle.solve", " does with ", "x[0]", ":"]
    assert [node.tagname for node in found] == ["#text", "literal", "#text", "literal", "#text"]


def test_a_formula_becomes_mathml():
    block = nodes.math_block("", r"S = U - W V^{-1} W^\top")
    converted = mathml.converted(block, as_block=True)
    assert re.search(r'<math [^>]*display="block"', converted)
    assert "<mi>W</mi>" in converted
    inline = mathml.converted(nodes.math("", "x_i"), as_block=False)
    assert "<msub>" in inline and 'display="block"' not in inline


def test_a_formula_that_cannot_be_converted_is_a_warning(monkeypatch):
    warnings = []
    monkeypatch.setattr(mathml.logger, "warning", lambda *given, **_: warnings.append(given))
    assert mathml.converted(nodes.math("", r"a < \nonsense"), as_block=False) == r"a &lt; \nonsense"
    assert r"\nonsense" in str(warnings)


@pytest.mark.parametrize(
    ("written", "on_the_page"),
    [
        ("[a](docs/align.md#errors)", "[a](../align.md#errors)"),
        ("[a](README.md)", "[a](../overview.md)"),
        ("[a](cpp/core/io/bal.h)", "[a](../../cpp/core/io/bal.h)"),
        ("[core](cpp/core), [`io`](cpp/core/io/)", "`core`, `io`"),
        ("![two](docs/bench.png) and [b](LICENSE)", "![two](../bench.png) and [b](../../LICENSE)"),
        ("[a](https://a.b/c.md), [b](#here)", "[a](https://a.b/c.md), [b](#here)"),
    ],
)
def test_links_of_a_file_that_a_page_shows(written, on_the_page):
    shown = repository_files.pages_that_show()
    page = ROOT / "docs" / "project" / "contributing.md"
    assert shown[ROOT / "CONTRIBUTING.md"] == page
    assert repository_files.relinked(written, ROOT / "CONTRIBUTING.md", page, shown) == on_the_page


def test_links_in_code_stay():
    text = "```python\nx = [a](b)\n```\n[a](README.md)\n"
    page = ROOT / "docs" / "align.md"
    found = repository_files.relinked(text, ROOT / "a.md", page, repository_files.pages_that_show())
    assert found == "```python\nx = [a](b)\n```\n[a](overview.md)\n"


def test_every_public_name_is_on_one_page():
    pages = [path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "api").glob("*.md")]
    fences = re.findall(r"^```\{public\} (.*)$", "\n".join(pages), re.MULTILINE)
    named = [name for fence in fences for name in fence.split()]
    assert sorted(named) == sorted(set(bundle.__all__) - {"__version__"})


def test_every_picture_is_in_the_gallery():
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert all(f"({path.name})" in gallery for path in (ROOT / "docs").glob("*.png"))
