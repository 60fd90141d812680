"""The directive ``public``: the documentation of public names of bundle, by Sphinx' autodoc.

```{public} load save Problem
```

Each name is what ``getattr(bundle, name)`` gives: a class with its members, a function, or a module
with the names of its ``__all__``. A name of ``bundle.__all__`` that no page has is a warning.
"""

from __future__ import annotations

import inspect
import re
from types import ModuleType
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import bundle

logger = logging.getLogger(__name__)


def reference(name: str, value: Any, module: str = "bundle") -> list[str]:
    """Return the lines of reStructuredText that document a name."""
    full = f"{module}.{name}"
    if isinstance(value, ModuleType):
        lines = [f".. automodule:: {full}", "   :no-members:", ""]
        for inner in getattr(value, "__all__", ()):
            if inner not in bundle.__all__:
                lines += reference(inner, getattr(value, inner), full)
        return lines
    if inspect.isclass(value):
        return [
            f".. autoclass:: {full}",
            "   :members:",
            "   :inherited-members: object, tuple, dict, BaseException",
            "   :exclude-members: core_arguments, with_traceback, add_note",
            "",
        ]
    kind = "function" if callable(value) else "data"
    return [f".. auto{kind}:: {full}", ""]


class Public(SphinxDirective):
    """``{public} NAME ...``."""

    required_arguments = 1
    optional_arguments = 100

    def run(self) -> list[nodes.Node]:
        """Return what autodoc makes of the names."""
        listed: dict[str, str] = self.env.__dict__.setdefault("public_names", {})
        self.env.note_dependency(__file__)
        lines: list[str] = []
        for name in self.arguments:
            if name not in bundle.__all__:
                raise self.error(f"public: expected a name of bundle.__all__, found {name}")
            if listed.get(name, self.env.docname) != self.env.docname:
                raise self.error(f"public: {name} is on the page {listed[name]} already")
            listed[name] = self.env.docname
            lines += reference(name, getattr(bundle, name))
        # The directives are those of reStructuredText, which the page need not be.
        rst = "```{eval-rst}\n" + "\n".join(lines) + "\n```"
        holder = nodes.container()
        self.state.nested_parse(StringList(rst.splitlines()), 0, holder)
        children: list[nodes.Node] = holder.children
        return children


def _all_are_documented(app: Any, env: Any) -> None:
    for name in bundle.__all__:
        if name != "__version__" and name not in getattr(env, "public_names", {}):
            logger.warning("bundle.%s is on no page: name it in docs/api", name)


def _forget(app: Any, env: Any, docname: str) -> None:
    listed: dict[str, str] = env.__dict__.setdefault("public_names", {})
    for name in [name for name, page in listed.items() if page == docname]:
        del listed[name]


def _escape(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Take bars, as of norms and absolute values, for what they are: not for substitutions."""
    in_block = False
    for number, line in enumerate(lines):
        if line.strip() and not line.startswith(" "):
            in_block = False
        if not in_block:
            parts = re.split(r"(``.+?``)", line)
            lines[number] = "".join(
                part if part.startswith("``") else part.replace("|", "\\|") for part in parts
            )
        in_block |= line.endswith("::")


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("public", Public)
    app.connect("autodoc-process-docstring", _escape, priority=400)  # before napoleon
    app.connect("env-purge-doc", _forget)
    app.connect("env-check-consistency", _all_are_documented)
    return {"version": "1", "parallel_read_safe": False, "parallel_write_safe": True}
