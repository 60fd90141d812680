"""Bundle adjustment that explains itself: load, refine, save reconstructions."""

from __future__ import annotations

TYPE_CHECKING = False  # as of typing, whose import takes longer than all that is here
if TYPE_CHECKING:
    from typing import Any

    from bundle import (
        constraints,
        figures,
        georeference,
        html,
        losses,
        pictures,
        two_loops,
        warning_kinds,
    )
    from bundle._core import __version__
    from bundle.camera_edits import (
        CameraModelChange,
        ChangedModels,
        change_camera_model,
        share_cameras,
        split_cameras,
    )
    from bundle.cameras import camera_models, project
    from bundle.checking import GradientReport, check_gradients, check_jacobians
    from bundle.comparison import Comparison, GraphComparison, compare
    from bundle.constraints import Constraints
    from bundle.diagnosis import Diagnosis, GraphDiagnosis, diagnose
    from bundle.errors import InputError
    from bundle.files import load, save
    from bundle.filters import MsckfUpdate, TrackRows, msckf_update, track_rows
    from bundle.free_degrees import GaugeFreedom, gauge_freedom
    from bundle.georeference import Alignment, GroundControlPoint, PositionPrior, align
    from bundle.graph import (
        BetweenFactor,
        DigitsLeft,
        FactorGraph,
        FunctionFactor,
        GraphResult,
        IncrementalSmoother,
        IncrementalUpdate,
        LinearPrior,
        PositionFactor,
        PriorFactor,
        PriorSpectrum,
        RelativePoseFactor,
        ReprojectionFactor,
        ScalarPriorFactor,
        SquareRootPrior,
        check_factors,
    )
    from bundle.headers import get_include
    from bundle.html import report
    from bundle.inertial import (
        BiasWalkFactor,
        Excitation,
        ImuFactor,
        ImuNoise,
        Preintegration,
        Repropagation,
        check_imu_samples,
        excitation,
        propagate,
    )
    from bundle.inspection import (
        GraphInspection,
        Inspection,
        MethodInspection,
        PoseGraphInspection,
        inspect,
        inspect_graph,
    )
    from bundle.loops import LoopClosing, LoopClosure, close_loops
    from bundle.merging import Merge, merge
    from bundle.options import SolveOptions
    from bundle.pose_graph import (
        PoseGraph,
        PoseGraphResult,
        PoseGraphSummary,
        initial_poses,
        pose_graph_chi2,
    )
    from bundle.pose_graph_options import PoseGraphOptions
    from bundle.problem import Problem
    from bundle.reprojection import ReprojectionError, reprojection_errors
    from bundle.result import Result
    from bundle.rig_config import apply_rig_config
    from bundle.rounds import Filtered, filter_observations, solve_rounds
    from bundle.solver import Solver, solve
    from bundle.statistics import Description, describe
    from bundle.summary import Summary
    from bundle.synthetic import FlightOptions, SceneOptions, SyntheticScene, synthesize
    from bundle.synthetic.flight import SyntheticFlight, synthesize_flight
    from bundle.two_loops import (
        ClosureLoop,
        PosePublisher,
        WindowLoop,
    )
    from bundle.uncertainty import Covariance, GraphCovariance, covariance
    from bundle.vio import (
        Calibration,
        FrameTracks,
        ImuInterval,
        KeyframeRecord,
        OdometryResult,
        Sequence,
        SlidingWindow,
        Trajectory,
        TrajectoryError,
        VioStart,
        WindowOptions,
        compare_trajectories,
        initialize_vio,
        load_sequence,
        load_trajectory,
        run_odometry,
        save_sequence,
    )

__all__ = [
    "Alignment",
    "BetweenFactor",
    "BiasWalkFactor",
    "Calibration",
    "CameraModelChange",
    "ChangedModels",
    "ClosureLoop",
    "Comparison",
    "Constraints",
    "Covariance",
    "Description",
    "Diagnosis",
    "DigitsLeft",
    "Excitation",
    "FactorGraph",
    "Filtered",
    "FlightOptions",
    "FrameTracks",
    "FunctionFactor",
    "GaugeFreedom",
    "GradientReport",
    "GraphComparison",
    "GraphCovariance",
    "GraphDiagnosis",
    "GraphInspection",
    "GraphResult",
    "GroundControlPoint",
    "ImuFactor",
    "ImuInterval",
    "ImuNoise",
    "IncrementalSmoother",
    "IncrementalUpdate",
    "InputError",
    "Inspection",
    "KeyframeRecord",
    "LinearPrior",
    "LoopClosing",
    "LoopClosure",
    "Merge",
    "MethodInspection",
    "MsckfUpdate",
    "OdometryResult",
    "PoseGraph",
    "PoseGraphInspection",
    "PoseGraphOptions",
    "PoseGraphResult",
    "PoseGraphSummary",
    "PosePublisher",
    "PositionFactor",
    "PositionPrior",
    "Preintegration",
    "PriorFactor",
    "PriorSpectrum",
    "Problem",
    "RelativePoseFactor",
    "ReprojectionError",
    "ReprojectionFactor",
    "Repropagation",
    "Result",
    "ScalarPriorFactor",
    "SceneOptions",
    "Sequence",
    "SlidingWindow",
    "SolveOptions",
    "Solver",
    "SquareRootPrior",
    "Summary",
    "SyntheticFlight",
    "SyntheticScene",
    "TrackRows",
    "Trajectory",
    "TrajectoryError",
    "VioStart",
    "WindowLoop",
    "WindowOptions",
    "__version__",
    "align",
    "apply_rig_config",
    "camera_models",
    "change_camera_model",
    "check_factors",
    "check_gradients",
    "check_imu_samples",
    "check_jacobians",
    "close_loops",
    "compare",
    "compare_trajectories",
    "constraints",
    "covariance",
    "describe",
    "diagnose",
    "excitation",
    "figures",
    "filter_observations",
    "gauge_freedom",
    "georeference",
    "get_include",
    "html",
    "initial_poses",
    "initialize_vio",
    "inspect",
    "inspect_graph",
    "load",
    "load_sequence",
    "load_trajectory",
    "losses",
    "merge",
    "msckf_update",
    "pictures",
    "pose_graph_chi2",
    "project",
    "propagate",
    "report",
    "reprojection_errors",
    "run_odometry",
    "save",
    "save_sequence",
    "share_cameras",
    "solve",
    "solve_rounds",
    "split_cameras",
    "synthesize",
    "synthesize_flight",
    "track_rows",
    "two_loops",
    "warning_kinds",
]

_DEFERRED = {
    "_core": ("__version__",),
    "camera_edits": (
        "CameraModelChange",
        "ChangedModels",
        "change_camera_model",
        "share_cameras",
        "split_cameras",
    ),
    "cameras": ("camera_models", "project"),
    "checking": ("GradientReport", "check_gradients", "check_jacobians"),
    "comparison": ("Comparison", "GraphComparison", "compare"),
    "constraints": ("Constraints",),
    "diagnosis": ("Diagnosis", "GraphDiagnosis", "diagnose"),
    "errors": ("InputError",),
    "georeference": ("Alignment", "GroundControlPoint", "PositionPrior", "align"),
    "graph": (
        "BetweenFactor",
        "DigitsLeft",
        "FactorGraph",
        "FunctionFactor",
        "GraphResult",
        "IncrementalSmoother",
        "IncrementalUpdate",
        "LinearPrior",
        "PositionFactor",
        "PriorFactor",
        "PriorSpectrum",
        "RelativePoseFactor",
        "ReprojectionFactor",
        "ScalarPriorFactor",
        "SquareRootPrior",
        "check_factors",
    ),
    "inertial": (
        "BiasWalkFactor",
        "Excitation",
        "ImuFactor",
        "ImuNoise",
        "Preintegration",
        "Repropagation",
        "check_imu_samples",
        "excitation",
        "propagate",
    ),
    "two_loops": ("ClosureLoop", "PosePublisher", "WindowLoop"),
    "filters": ("MsckfUpdate", "TrackRows", "msckf_update", "track_rows"),
    "free_degrees": ("GaugeFreedom", "gauge_freedom"),
    "headers": ("get_include",),
    "inspection": (
        "GraphInspection",
        "Inspection",
        "MethodInspection",
        "PoseGraphInspection",
        "inspect",
        "inspect_graph",
    ),
    "files": ("load", "save"),
    "loops": ("LoopClosing", "LoopClosure", "close_loops"),
    "merging": ("Merge", "merge"),
    "options": ("SolveOptions",),
    "pose_graph": (
        "PoseGraph",
        "PoseGraphResult",
        "PoseGraphSummary",
        "initial_poses",
        "pose_graph_chi2",
    ),
    "pose_graph_options": ("PoseGraphOptions",),
    "problem": ("Problem",),
    "reprojection": ("ReprojectionError", "reprojection_errors"),
    "result": ("Result",),
    "rig_config": ("apply_rig_config",),
    "rounds": ("Filtered", "filter_observations", "solve_rounds"),
    "solver": ("Solver", "solve"),
    "statistics": ("Description", "describe"),
    "summary": ("Summary",),
    "synthetic": ("FlightOptions", "SceneOptions", "SyntheticScene", "synthesize"),
    "synthetic.flight": ("SyntheticFlight", "synthesize_flight"),
    "uncertainty": ("Covariance", "GraphCovariance", "covariance"),
    "vio": (
        "Calibration",
        "FrameTracks",
        "ImuInterval",
        "KeyframeRecord",
        "OdometryResult",
        "Sequence",
        "SlidingWindow",
        "Trajectory",
        "TrajectoryError",
        "VioStart",
        "WindowOptions",
        "compare_trajectories",
        "initialize_vio",
        "load_sequence",
        "load_trajectory",
        "run_odometry",
        "save_sequence",
    ),
    "figures": (),
    "html": ("report",),
    "losses": (),
    "pictures": (),
    "warning_kinds": (),
}
"""Modules that are imported when first asked for (PEP 562), with the names that they give.

The command line starts here, and its first act must be to take care of Ctrl-C.
"""


def __getattr__(name: str) -> Any:
    for module, names in _DEFERRED.items():
        if name == module or name in names:
            import importlib

            found = importlib.import_module(f"bundle.{module}")
            value = globals()[name] = found if name == module else getattr(found, name)
            return value
    raise AttributeError(f"module 'bundle' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
