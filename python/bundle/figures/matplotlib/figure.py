"""Matplotlib, which is optional: where it is asked for, and what is said where it is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bundle.errors import InputError
from bundle.interface.option_fields import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["figure"]


def figure(
    num_rows: int = 1, num_columns: int = 1, *, width: float = 4.0, height: float = 4.0
) -> tuple[Figure, Any]:
    """Return a figure and its (num_rows, num_columns) axes, each ``width`` by ``height`` inches.

    The figure belongs to no window and no global state; ``figure.savefig("a.svg")`` writes it, as
    PNG or SVG by the name.

    Raises:
        InputError: Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError(
            "pictures: expected Matplotlib, found none; install it with pip install matplotlib"
        ) from None
    num_rows = number("num_rows", num_rows, whole=True, minimum=1, maximum=100)
    num_columns = number("num_columns", num_columns, whole=True, minimum=1, maximum=100)
    width = number("width", width, above=0, maximum=1000)
    height = number("height", height, above=0, maximum=1000)
    made = Figure(figsize=(num_columns * width, num_rows * height), layout="constrained")
    made.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08)
    return made, made.subplots(num_rows, num_columns, squeeze=False)
