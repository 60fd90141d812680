"""Table of every option class, by name.

The command line, the documentation and the tests find the classes here. Each class is imported on
first use, because a command needs few of them.
"""

from __future__ import annotations

import importlib

from bundle.interface.option_class import Options

OPTION_CLASSES = {
    "CheckOptions": "analysis_options",
    "CheckpointOptions": "round_options",
    "CompareOptions": "planning_options",
    "CovarianceOptions": "analysis_options",
    "EvaluateOptions": "judging_options",
    "FlightOptions": "scene_options",
    "GeoreferenceOptions": "georeference_options",
    "GraphFileOptions": "planning_options",
    "GraphOptions": "options",
    "HoldOutOptions": "judging_options",
    "LensOptions": "camera_edit_options",
    "LocalOptions": "round_options",
    "LoopOptions": "pose_graph_options",
    "OutOfCoreOptions": "round_options",
    "PoseGraphOptions": "pose_graph_options",
    "RankOptions": "planning_options",
    "RoundOptions": "round_options",
    "RuleOptions": "camera_edit_options",
    "SceneOptions": "scene_options",
    "ShapeOptions": "planning_options",
    "ShutterOptions": "camera_edit_options",
    "SolveOptions": "options",
    "TrackingOptions": "window_options",
    "TriageOptions": "judging_options",
    "ValidationOptions": "judging_options",
    "WindowOptions": "window_options",
}
"""Option classes, with the modules of this package that define them."""


def option_class(name: str) -> type[Options]:
    """Import and return the option class with a name."""
    module = importlib.import_module(f"bundle.interface.{OPTION_CLASSES[name]}")
    kind: type[Options] = getattr(module, name)
    return kind
