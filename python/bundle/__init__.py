"""Bundle adjustment that explains itself: load, refine, save reconstructions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bundle import address_space as address_space  # first: it looks whether the rest has room
from bundle._core import __version__
from bundle.cameras import camera_models, project
from bundle.errors import InputError
from bundle.headers import get_include
from bundle.io import load, save
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.reprojection import ReprojectionError
from bundle.result import Result
from bundle.solver import solve
from bundle.summary import Summary

if TYPE_CHECKING:
    from bundle.checking import GradientReport, check_gradients, check_jacobians
    from bundle.comparison import Comparison, compare
    from bundle.inspection import (
        GraphInspection,
        Inspection,
        MethodInspection,
        inspect,
        inspect_graph,
    )
    from bundle.synthetic import SceneOptions, SyntheticScene, synthesize

__all__ = [
    "Comparison",
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
    "get_include",
    "inspect",
    "inspect_graph",
    "load",
    "project",
    "save",
    "solve",
    "synthesize",
]


def __getattr__(name: str) -> Any:
    """Import what few need when they ask for it (PEP 562): every command starts here."""
    if name in ("SceneOptions", "SyntheticScene", "synthesize"):
        from bundle import synthetic

        return getattr(synthetic, name)
    if name in ("Comparison", "compare"):
        from bundle import comparison

        return getattr(comparison, name)
    if name in ("GradientReport", "check_gradients", "check_jacobians"):
        from bundle import checking

        return getattr(checking, name)
    if name in (
        "GraphInspection",
        "Inspection",
        "MethodInspection",
        "inspect",
        "inspect_graph",
    ):
        from bundle import inspection

        return getattr(inspection, name)
    raise AttributeError(f"module 'bundle' has no attribute {name!r}")
