"""The page of a problem: what each way to solve it will cost, and why."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.html.charts import bars
from bundle.html.elimination import elimination_data, elimination_section
from bundle.html.graph import column_counts, write_graph
from bundle.html.matrices import covisibility, matrix, orderings
from bundle.html.numbers import amount, memory, seconds
from bundle.html.page import tag, write_page
from bundle.html.subgraph import image_graph
from bundle.html.table import convention, table
from bundle.inspection import GraphInspection, Inspection, MethodInspection, inspect_graph
from bundle.pictures.block_pattern import BlockPattern
from bundle.pictures.covisibility import covisibility_graph

__all__ = ["write_inspection"]

ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis")
STEPPED = ("natural", "minimum_degree")
MOST_EDGES = 1500


def write_inspection(
    inspection: Inspection | GraphInspection | Sequence[GraphInspection],
    path: str | os.PathLike[str],
) -> None:
    """Write an inspection as one HTML file that needs nothing else.

    Args:
        inspection: of a problem, or of a graph under one order or several.
        path: of the file, which appears whole or not at all.

    Raises:
        InputError: the path is a folder, or its parent is none.
        OSError: the file cannot be written.
    """
    if isinstance(inspection, GraphInspection):
        write_graph([inspection], path)
    elif not isinstance(inspection, Inspection):
        write_graph(inspection, path)
    else:
        _write_problem(inspection, path)
