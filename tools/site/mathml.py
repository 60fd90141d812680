"""Formulae as MathML, which browsers render by themselves: no script, no font, no network.

The converter is that of docutils, on which Sphinx stands. A formula that it does not understand is
a warning, and so fails `make docs`.
"""

from __future__ import annotations

import html
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

logger = logging.getLogger(__name__)


def converted(node: nodes.Element, as_block: bool) -> str:
    """Return a formula as MathML, the TeX as it stands where that cannot be converted."""
    formula = node.astext()
    try:
        return str(tex2mathml(formula, as_block=as_block))
    except MathError as error:
        logger.warning("formula %s: %s", formula, error, location=node)
        return html.escape(formula, quote=False)


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(converted(node, as_block=False))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    formula = converted(node, as_block=True)
    writer.body.append(f'<div class="formula">{formula}</div>\n')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer, which conf.py chooses."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
