"""Bundle adjustment that explains itself: load, refine, save reconstructions."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from bundle import address_space as address_space  # first: it looks whether the rest has room
from bundle._core import __version__
from bundle.cameras import camera_models, project
from bundle.errors import InputError
from bundle.headers import get_include
from bundle.io import load, save
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.reprojection import ReprojectionError, reprojection_errors
from bundle.result import Result
from bundle.solver import solve
from bundle.summary import Summary

if TYPE_CHECKING:
    from bundle import html, losses, pictures
    from bundle.checking import GradientReport, check_gradients, check_jacobians
    from bundle.comparison import Comparison, compare
    from bundle.inspection import (
        GraphInspection,
        Inspection,
        MethodInspection,
        inspect,
        inspect_graph,
    )
    from bundle.statistics import Description, describe
    from bundle.synthetic import SceneOptions, SyntheticScene, synthesize

__all__ = [
    "Comparison",
    "Description",
    "GradientReport",
    "GraphInspection",
    "InputError",
    "Inspection",
    "MethodInspection",
    "Problem",
    "ReprojectionError",
    "Result",
    "SceneOptions",
    "SolveOptions",
    "Summary",
    "SyntheticScene",
    "__version__",
    "camera_models",
    "check_gradients",
    "check_jacobians",
    "compare",
    "describe",
    "get_include",
    "html",
    "inspect",
    "inspect_graph",
    "load",
    "losses",
    "pictures",
    "project",
    "reprojection_errors",
    "save",
    "solve",
    "synthesize",
]

_DEFERRED = {
    "checking": ("GradientReport", "check_gradients", "check_jacobians"),
    "comparison": ("Comparison", "compare"),
    "inspection": (
        "GraphInspection",
        "Inspection",
        "MethodInspection",
        "inspect",
        "inspect_graph",
    ),
    "statistics": ("Description", "describe"),
    "synthetic": ("SceneOptions", "SyntheticScene", "synthesize"),
    "html": (),
    "losses": (),
    "pictures": (),
}
"""Packages that are imported when first asked for (PEP 562), with the names that they give."""


def __getattr__(name: str) -> Any:
    for package, names in _DEFERRED.items():
        if name == package and not names:
            return importlib.import_module(f"bundle.{package}")
        if name in names:
            return getattr(importlib.import_module(f"bundle.{package}"), name)
    raise AttributeError(f"module 'bundle' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
