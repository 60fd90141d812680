"""Tables of the commands: their help texts, and their handlers by kind of input.

Handlers are names, not imports, so that a command imports only the modules that it needs.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from typing import Any

from bundle.io.recognition import Kind, recognize

__all__ = [
    "COMMANDS",
    "FLIGHT",
    "GRAPH_FILE",
    "HANDLERS",
    "SEVERAL",
    "SHAPE",
    "find_handler",
    "kind_of_input",
]

COMMANDS = {
    "info": "what a reconstruction holds, its reprojection error [px] now, and what looks wrong",
    "inspect": "what each way to solve a problem will cost: nonzeros, fill, flops, memory, time "
    "per step",
    "refine": "bundle adjustment: poses, points and intrinsics that explain the observations best; "
    "of a pose graph (.g2o) the poses that explain its edges best",
    "compare": "the same start under several solvers: measured, and one of them recommended",
    "validate": "which lens model, sharing and loss predict observations best: k folds, one "
    "recommendation",
    "check": "validates the analytic Jacobians on this very problem, or those of your own factors "
    "(FILE.py:NAME), and names what is wrong",
    "covariance": "how certain poses, points and intrinsics, or the poses of a pose graph are: "
    "their marginal covariances",
    "diagnose": "what the observations, or the edges of a pose graph, do not determine, and why: "
    "rank, weak directions, pieces, points, suspicious edges",
    "align": "puts a reconstruction where GPS, control points or another model say it is",
    "merge": "makes two reconstructions of partly the same images one",
    "evaluate": "errors of a model or trajectory A against a reference: truth, or another model",
    "report": "one page (HTML, no network) on a reconstruction: residuals, lenses, tracks, a 3-D "
    "view; on a pose graph: errors by kind of edge, worst edges, structure, trajectory",
    "triage": "names the cause of the difference between two reports of one input: ordering, fill, "
    "prior, Jacobian, machine, data, options or convergence",
    "vio": "visual-inertial odometry from feature tracks and IMU samples",
    "convert": "between formats, saying what is lost",
    "synth": "seeded synthetic scenes with ground truth, from toy to millions of observations",
    "demo": "refines a small scene that comes with the package, and writes a report page",
}
"""Commands in the order of the help, with their help texts."""

SEVERAL = "several inputs"
GRAPH_FILE = "file of a graph"
SHAPE = "numbers of cameras and points"
FLIGHT = "flight"

HANDLERS = {
    ("info", SEVERAL): "info:run",
    ("info", Kind.RECONSTRUCTION): "info:describe_reconstruction",
    ("info", Kind.POSE_GRAPH): "pose_graph_commands:describe",
    ("info", Kind.SEQUENCE): "sequence_commands:describe",
    ("inspect", Kind.RECONSTRUCTION): "inspect:run",
    ("inspect", Kind.POSE_GRAPH): "pose_graph_costs:inspect_graph",
    ("inspect", GRAPH_FILE): "inspect_graph_file:run",
    ("inspect", SHAPE): "inspect_numbers:run",
    ("refine", Kind.RECONSTRUCTION): "refine:run",
    ("refine", Kind.POSE_GRAPH): "pose_graph_commands:refine",
    ("compare", Kind.RECONSTRUCTION): "compare:run",
    ("compare", Kind.POSE_GRAPH): "pose_graph_costs:compare_graph",
    ("validate", Kind.RECONSTRUCTION): "validate:run",
    ("check", Kind.RECONSTRUCTION): "check:run",
    ("check", Kind.POSE_GRAPH): "check_factors:check_edges_of_file",
    ("check", Kind.PYTHON): "check_factors:check_object",
    ("covariance", Kind.RECONSTRUCTION): "covariance:run",
    ("covariance", Kind.POSE_GRAPH): "pose_graph_analyses:compute_covariance",
    ("diagnose", Kind.RECONSTRUCTION): "diagnose:run",
    ("diagnose", Kind.POSE_GRAPH): "pose_graph_analyses:diagnose",
    ("align", Kind.RECONSTRUCTION): "align:run",
    ("merge", Kind.RECONSTRUCTION): "merge:run",
    ("evaluate", Kind.RECONSTRUCTION): "evaluate:run",
    ("report", Kind.RECONSTRUCTION): "report:run",
    ("report", Kind.POSE_GRAPH): "pose_graph_report:run",
    ("triage", Kind.RECONSTRUCTION): "triage:run",
    ("vio", Kind.RECONSTRUCTION): "vio:run",
    ("convert", Kind.RECONSTRUCTION): "convert:run",
    ("convert", Kind.POSE_GRAPH): "pose_graph_commands:convert",
    ("convert", Kind.SEQUENCE): "sequence_commands:convert",
    ("synth", Kind.RECONSTRUCTION): "synth:run",
    ("synth", FLIGHT): "flight_synthesis:run",
    ("demo", Kind.RECONSTRUCTION): "demo:run",
}
"""Functions in this package that run a command, by the kind of its input.

Other kinds go to the reader of reconstructions, whose error names the kind.
"""


def find_handler(command: str, kind: str) -> Callable[..., Any]:
    """Import the function that runs a command for a kind of input."""
    name = HANDLERS.get((command, kind)) or HANDLERS[command, Kind.RECONSTRUCTION]
    module, _, function = name.partition(":")
    handler: Callable[..., Any] = getattr(importlib.import_module(f"bundle.cli.{module}"), function)
    return handler


def kind_of_input(arguments: argparse.Namespace) -> str:
    """Detect the kind of INPUT; several inputs are pose graphs if one of them is."""
    paths = [arguments.input] if "input" in arguments else getattr(arguments, "inputs", [])
    kinds = {recognize(path) for path in paths}
    if len(kinds) == 1:
        return kinds.pop()
    return Kind.POSE_GRAPH if Kind.POSE_GRAPH in kinds else Kind.RECONSTRUCTION
