"""Tables of the commands: their help texts, and their handlers by kind of input.

Handlers are names, not imports, so that a command imports only the modules that it needs.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from typing import Any

from bundle.io.recognition import Kind, recognize

COMMANDS = {
    "info": "counts, cameras, tracks, reprojection errors [px], and warnings",
    "inspect": "predict nonzeros, fill-in, flops, memory and time per step of each solver",
    "refine": "bundle adjustment of a model, or optimisation of a pose graph (.g2o)",
    "compare": "solve from the same start with several solvers, and recommend one",
    "validate": "cross-validate lens models, sharing of cameras and losses, and recommend one",
    "check": "check the analytic Jacobians of this problem, or of your own factors "
    "(FILE.py:NAME), and name mistakes",
    "covariance": "marginal covariances of poses, points and intrinsics, or of the poses of a "
    "pose graph",
    "diagnose": "find undetermined parameters of a model or pose graph: rank, weak directions, "
    "components, suspicious edges",
    "align": "georeference a model by GPS or control points, or align it to another model",
    "merge": "merge two models that share images",
    "evaluate": "errors of a model or trajectory A against a reference: truth, or another model",
    "report": "write a page (HTML, no network) on a model or pose graph: verdicts, residuals, "
    "worst images or edges, a 3-D view",
    "triage": "name the cause of the difference between two reports of one input: ordering, fill, "
    "prior, Jacobian, machine, data, options or convergence",
    "vio": "visual-inertial odometry from images, a recording or feature tracks, and IMU samples",
    "convert": "convert between formats, and list what is lost",
    "synth": "make a seeded scene with ground truth, from toy to millions of observations",
    "demo": "refine a small scene that comes with the package, and write a report page",
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
    ("inspect", GRAPH_FILE): "inspect:run_graph_file",
    ("inspect", SHAPE): "inspect:run_numbers",
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
    ("synth", FLIGHT): "synth:run_flight",
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
