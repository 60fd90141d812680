"""A solve as the user would type it."""

from __future__ import annotations

import dataclasses
import shlex
from typing import Any

from bundle.options import SolveOptions

__all__ = ["command_line"]


def command_line(options: SolveOptions, source: str = "INPUT", output: str = "OUTPUT") -> str:
    """Return the `bundle refine` that solves with these options; only what differs is named."""
    words = ["bundle", "refine", source, "-o", output]
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if value != field.default:
            words += _flag(field, value)
    return shlex.join(words)


def _flag(field: dataclasses.Field[Any], value: Any) -> list[str]:
    flag = field.metadata["flag"]
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag.lstrip('-')}"]
    text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
    named = field.metadata["choices"] is not None or field.name == "refine"
    return [flag, text.replace("_", "-") if named else text]
