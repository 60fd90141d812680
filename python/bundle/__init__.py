"""Bundle adjustment that explains itself: load, refine, save reconstructions."""

from bundle._core import __version__
from bundle.cameras import camera_models, project
from bundle.errors import InputError
from bundle.io import load, save
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.result import ReprojectionError, Result, Summary
from bundle.solver import solve
from bundle.synthetic import SceneOptions, SyntheticScene, synthesize

__all__ = [
    "InputError",
    "Problem",
    "ReprojectionError",
    "Result",
    "SceneOptions",
    "SolveOptions",
    "Summary",
    "SyntheticScene",
    "__version__",
    "camera_models",
    "load",
    "project",
    "save",
    "solve",
    "synthesize",
]
