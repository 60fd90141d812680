"""Table of every option class, by name.

The command line, the documentation and the tests find the classes here. Each class is imported on
first use, because a command needs few of them.
"""

from __future__ import annotations

import importlib

from bundle.interface.option_class import Options

OPTION_CLASSES = {
    "CheckOptions": "check_options",
    "CheckpointOptions": "round_options",
    "CompareOptions": "compare_options",
    "CovarianceOptions": "covariance_options",
    "EvaluateOptions": "evaluate_options",
    "FlightOptions": "flight_options",
    "GeoreferenceOptions": "georeference_options",
    "GraphFileOptions": "inspect_options",
    "GraphOptions": "options",
    "HoldOutOptions": "validation_options",
    "LensOptions": "camera_edit_options",
    "LocalOptions": "round_options",
    "LoopOptions": "loop_options",
    "OutOfCoreOptions": "out_of_core_options",
    "PoseGraphOptions": "pose_graph_options",
    "RankOptions": "inspect_options",
    "RoundOptions": "round_options",
    "RuleOptions": "camera_edit_options",
    "SceneOptions": "scene_options",
    "ShapeOptions": "inspect_options",
    "ShutterOptions": "rolling_shutter_options",
    "SolveOptions": "options",
    "TrackingOptions": "tracking_options",
    "TriageOptions": "triage_options",
    "ValidationOptions": "validation_options",
    "WindowOptions": "window_options",
}
"""Option classes, with the modules of this package that define them."""


def option_class(name: str) -> type[Options]:
    """Import and return the option class with a name."""
    module = importlib.import_module(f"bundle.interface.{OPTION_CLASSES[name]}")
    kind: type[Options] = getattr(module, name)
    return kind
