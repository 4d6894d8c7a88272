"""Formulas as MathML, which browsers draw themselves: no script, and none from another host."""

from __future__ import annotations

from html import escape
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging


def _written(self: Any, node: nodes.Node, block: bool) -> None:
    try:
        formula = tex2mathml(node.astext(), as_block=block)
    except MathError as error:
        logging.getLogger(__name__).warning("formula %r: %s", node.astext(), error, location=node)
        formula = f"<code>{escape(node.astext())}</code>"
    self.body.append(f'<div class="formula">{formula}</div>' if block else formula)
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the renderer ``mathml``."""
    app.add_html_math_renderer(
        "mathml",
        (lambda self, node: _written(self, node, block=False), None),
        (lambda self, node: _written(self, node, block=True), None),
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
