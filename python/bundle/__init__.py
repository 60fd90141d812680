"""Bundle adjustment that explains itself: load, refine, save reconstructions."""

from __future__ import annotations

TYPE_CHECKING = False  # as typing.TYPE_CHECKING; importing typing would be slower than this module
if TYPE_CHECKING:
    from typing import Any

    from bundle import figures, georeference
    from bundle._core import __version__
    from bundle.analysis.diagnosis.chi2_kinds import Chi2Kind, chi2_kinds
    from bundle.analysis.diagnosis.diagnose_problem import diagnose
    from bundle.analysis.diagnosis.diagnosis_result import Diagnosis, GraphDiagnosis
    from bundle.analysis.statistics.description import Description, describe
    from bundle.analysis.uncertainty.covariance_by_input import covariance
    from bundle.analysis.uncertainty.covariance_result import (
        Covariance,
        FactorGraphCovariance,
        GraphCovariance,
    )
    from bundle.base.paths import get_include
    from bundle.checking.gradient_report import GradientReport
    from bundle.editing.cameras.camera_sharing import share_cameras, split_cameras
    from bundle.editing.cameras.model_change import (
        CameraModelChange,
        ChangedModels,
        change_camera_model,
    )
    from bundle.editing.global_shutter import GlobalShutterModel, to_global_shutter
    from bundle.editing.merging.merge_models import merge
    from bundle.editing.merging.merge_result import Merge
    from bundle.editing.rig_config import apply_rig_config
    from bundle.errors import InputError
    from bundle.figures import matplotlib as pictures
    from bundle.georeference.alignment import align
    from bundle.georeference.alignment_result import Alignment
    from bundle.georeference.attitude_priors import GravityPrior, HeadingPrior, OrientationPrior
    from bundle.georeference.control_point import GroundControlPoint
    from bundle.georeference.position_prior import PositionPrior
    from bundle.georeference.velocity_prior import VelocityPrior
    from bundle.graphs.factors.attitude_factors import (
        DirectionFactor,
        HeadingFactor,
        RotationFactor,
    )
    from bundle.graphs.factors.checks import check_gradients, check_jacobians
    from bundle.graphs.factors.factor_graph import DigitsLeft, FactorGraph, GraphResult
    from bundle.graphs.factors.factors import (
        BetweenFactor,
        FunctionFactor,
        PositionFactor,
        PriorFactor,
        RelativePoseFactor,
        ReprojectionFactor,
        ScalarPriorFactor,
    )
    from bundle.graphs.factors.incremental_smoother import IncrementalSmoother, IncrementalUpdate
    from bundle.graphs.factors.linear_prior import LinearPrior, PriorSpectrum, SquareRootPrior
    from bundle.graphs.factors.problem_factors import check_factors
    from bundle.graphs.loops.loop_closing import LoopClosing, LoopClosure
    from bundle.graphs.loops.loop_graph import close_loops
    from bundle.graphs.pose_graphs.certificate import Certificate, Staircase
    from bundle.graphs.pose_graphs.certify import certify
    from bundle.graphs.pose_graphs.edge_weights import initial_poses, pose_graph_chi2
    from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult, PoseGraphSummary
    from bundle.inertial import two_loops
    from bundle.inertial.preintegration.imu_factors import BiasWalkFactor, ImuFactor
    from bundle.inertial.preintegration.motion_excitation import Excitation, excitation
    from bundle.inertial.preintegration.preintegration import Preintegration, propagate
    from bundle.inertial.preintegration.repropagation import Repropagation
    from bundle.inertial.tracking.track_images import TrackedImages, track_images
    from bundle.inertial.tracking.track_recording import Tracking
    from bundle.inertial.two_loops.closure_loop import ClosureLoop
    from bundle.inertial.two_loops.pose_publisher import PosePublisher
    from bundle.inertial.two_loops.window_loop import WindowLoop
    from bundle.inertial.vio.initialize import VioStart, initialize_vio
    from bundle.inertial.vio.keyframe_record import KeyframeRecord
    from bundle.inertial.vio.landmark_table import FrameTracks
    from bundle.inertial.vio.msckf import MsckfUpdate, TrackRows, msckf_update, track_rows
    from bundle.inertial.vio.odometry import OdometryResult, run_odometry
    from bundle.inertial.vio.sliding_window import SlidingWindow
    from bundle.inertial.vio.trajectory_comparison import TrajectoryError, compare_trajectories
    from bundle.inertial.vio.window_frame import ImuInterval
    from bundle.interface import warning_kinds
    from bundle.interface.evaluate_options import EvaluateOptions
    from bundle.interface.flight_options import FlightOptions
    from bundle.interface.options import SolveOptions
    from bundle.interface.pose_graph_options import PoseGraphOptions
    from bundle.interface.progress_bar import ProgressBar
    from bundle.interface.scene_options import SceneOptions
    from bundle.interface.summary import Summary
    from bundle.interface.tracking_options import TrackingOptions
    from bundle.interface.triage_options import TriageOptions
    from bundle.interface.window_options import WindowOptions
    from bundle.io.files import load, reprojection_errors, save
    from bundle.io.formats.registry import Format
    from bundle.io.pose_files import load_poses
    from bundle.io.sequences.sequence_folder import load_sequence, save_sequence
    from bundle.io.sequences.trajectory_files import Trajectory, load_trajectory
    from bundle.judging.evaluation.check_points import CheckPointEvaluation
    from bundle.judging.evaluation.evaluate_models import evaluate
    from bundle.judging.evaluation.evaluation_result import Evaluation
    from bundle.judging.triage.cause_words import TriageCause
    from bundle.judging.triage.triage_reports import triage
    from bundle.judging.triage.triage_result import Triage
    from bundle.judging.validation.validate_problem import validate
    from bundle.judging.validation.validation_result import ValidatedCandidate, Validation
    from bundle.model import losses
    from bundle.model.cameras import camera_models, project
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.model.pose_table import PoseTable
    from bundle.model.problem import Problem
    from bundle.model.reprojection import ReprojectionError
    from bundle.model.rolling_shutter import RollingShutter
    from bundle.model.selection import Selection
    from bundle.model.sequence.calibration import Calibration
    from bundle.model.sequence.imu_noise import ImuNoise
    from bundle.model.sequence.imu_samples import check_imu_samples
    from bundle.model.sequence.sequence import Sequence
    from bundle.planning.comparison.compare_methods import compare
    from bundle.planning.comparison.comparison_result import Comparison, read_comparison
    from bundle.planning.comparison.graph_comparison import GraphComparison
    from bundle.planning.inspection.factor_graph_inspection import FactorGraphInspection
    from bundle.planning.inspection.graph_inspection import GraphInspection, inspect_graph
    from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
    from bundle.planning.inspection.pose_graph_inspection import PoseGraphInspection
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.reports import page as html
    from bundle.reports.page import report
    from bundle.reports.saved_report import save_report
    from bundle.solving import constraints
    from bundle.solving.colmap_adjustment.bundle_adjustment import bundle_adjustment
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.gauge_freedom import GaugeFreedom, gauge_freedom
    from bundle.solving.held_out.hold_out import hold_out
    from bundle.solving.result import Result
    from bundle.solving.rounds.filtering import Filtered, filter_observations
    from bundle.solving.rounds.solve_rounds import solve_rounds
    from bundle.solving.solve import solve
    from bundle.solving.solver import Solver
    from bundle.synthetic.flight.synthetic_flight import SyntheticFlight, synthesize_flight
    from bundle.synthetic.synthesis import SyntheticScene, synthesize

__all__ = [
    "Alignment",
    "BetweenFactor",
    "BiasWalkFactor",
    "Calibration",
    "CameraModelChange",
    "Certificate",
    "ChangedModels",
    "CheckPointEvaluation",
    "Chi2Kind",
    "ClosureLoop",
    "Comparison",
    "Constraints",
    "Covariance",
    "Description",
    "Diagnosis",
    "DigitsLeft",
    "DirectionFactor",
    "EvaluateOptions",
    "Evaluation",
    "Excitation",
    "FactorGraph",
    "FactorGraphCovariance",
    "FactorGraphInspection",
    "Filtered",
    "FlightOptions",
    "Format",
    "FrameTracks",
    "FunctionFactor",
    "GaugeFreedom",
    "GlobalShutterModel",
    "GradientReport",
    "GraphComparison",
    "GraphCovariance",
    "GraphDiagnosis",
    "GraphInspection",
    "GraphResult",
    "GravityPrior",
    "GroundControlPoint",
    "HeadingFactor",
    "HeadingPrior",
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
    "OrientationPrior",
    "PoseGraph",
    "PoseGraphInspection",
    "PoseGraphOptions",
    "PoseGraphResult",
    "PoseGraphSummary",
    "PosePublisher",
    "PoseTable",
    "PositionFactor",
    "PositionPrior",
    "Preintegration",
    "PriorFactor",
    "PriorSpectrum",
    "Problem",
    "ProgressBar",
    "RelativePoseFactor",
    "ReprojectionError",
    "ReprojectionFactor",
    "Repropagation",
    "Result",
    "RollingShutter",
    "RotationFactor",
    "ScalarPriorFactor",
    "SceneOptions",
    "Selection",
    "Sequence",
    "SlidingWindow",
    "SolveOptions",
    "Solver",
    "SquareRootPrior",
    "Staircase",
    "Summary",
    "SyntheticFlight",
    "SyntheticScene",
    "TrackRows",
    "TrackedImages",
    "Tracking",
    "TrackingOptions",
    "Trajectory",
    "TrajectoryError",
    "Triage",
    "TriageCause",
    "TriageOptions",
    "ValidatedCandidate",
    "Validation",
    "VelocityPrior",
    "VioStart",
    "WindowLoop",
    "WindowOptions",
    "__version__",
    "align",
    "apply_rig_config",
    "bundle_adjustment",
    "camera_models",
    "certify",
    "change_camera_model",
    "check_factors",
    "check_gradients",
    "check_imu_samples",
    "check_jacobians",
    "chi2_kinds",
    "close_loops",
    "compare",
    "compare_trajectories",
    "constraints",
    "covariance",
    "describe",
    "diagnose",
    "evaluate",
    "excitation",
    "figures",
    "filter_observations",
    "gauge_freedom",
    "georeference",
    "get_include",
    "hold_out",
    "html",
    "initial_poses",
    "initialize_vio",
    "inspect",
    "inspect_graph",
    "load",
    "load_poses",
    "load_sequence",
    "load_trajectory",
    "losses",
    "merge",
    "msckf_update",
    "pictures",
    "pose_graph_chi2",
    "project",
    "propagate",
    "read_comparison",
    "report",
    "reprojection_errors",
    "run_odometry",
    "save",
    "save_report",
    "save_sequence",
    "share_cameras",
    "solve",
    "solve_rounds",
    "split_cameras",
    "synthesize",
    "synthesize_flight",
    "to_global_shutter",
    "track_images",
    "track_rows",
    "triage",
    "two_loops",
    "validate",
    "warning_kinds",
]

_DEFERRED = {
    "_core": ("__version__",),
    "analysis.diagnosis.chi2_kinds": ("Chi2Kind", "chi2_kinds"),
    "analysis.diagnosis.diagnose_problem": ("diagnose",),
    "analysis.diagnosis.diagnosis_result": ("Diagnosis", "GraphDiagnosis"),
    "analysis.statistics.description": ("Description", "describe"),
    "analysis.uncertainty.covariance_by_input": ("covariance",),
    "analysis.uncertainty.covariance_result": (
        "Covariance",
        "FactorGraphCovariance",
        "GraphCovariance",
    ),
    "base.paths": ("get_include",),
    "checking.gradient_report": ("GradientReport",),
    "editing.cameras.camera_sharing": ("share_cameras", "split_cameras"),
    "editing.global_shutter": ("GlobalShutterModel", "to_global_shutter"),
    "editing.cameras.model_change": ("CameraModelChange", "ChangedModels", "change_camera_model"),
    "editing.merging.merge_models": ("merge",),
    "editing.merging.merge_result": ("Merge",),
    "editing.rig_config": ("apply_rig_config",),
    "errors": ("InputError",),
    "georeference.alignment": ("align",),
    "georeference.alignment_result": ("Alignment",),
    "georeference.attitude_priors": ("GravityPrior", "HeadingPrior", "OrientationPrior"),
    "georeference.control_point": ("GroundControlPoint",),
    "georeference.position_prior": ("PositionPrior",),
    "georeference.velocity_prior": ("VelocityPrior",),
    "graphs.factors.attitude_factors": ("DirectionFactor", "HeadingFactor", "RotationFactor"),
    "graphs.factors.checks": ("check_gradients", "check_jacobians"),
    "graphs.factors.factor_graph": ("DigitsLeft", "FactorGraph", "GraphResult"),
    "graphs.factors.factors": (
        "BetweenFactor",
        "FunctionFactor",
        "PositionFactor",
        "PriorFactor",
        "RelativePoseFactor",
        "ReprojectionFactor",
        "ScalarPriorFactor",
    ),
    "graphs.factors.incremental_smoother": ("IncrementalSmoother", "IncrementalUpdate"),
    "graphs.factors.linear_prior": ("LinearPrior", "PriorSpectrum", "SquareRootPrior"),
    "graphs.factors.problem_factors": ("check_factors",),
    "graphs.loops.loop_closing": ("LoopClosing", "LoopClosure"),
    "graphs.loops.loop_graph": ("close_loops",),
    "graphs.pose_graphs.certificate": ("Certificate", "Staircase"),
    "graphs.pose_graphs.certify": ("certify",),
    "graphs.pose_graphs.edge_weights": ("initial_poses", "pose_graph_chi2"),
    "graphs.pose_graphs.pose_graph_result": ("PoseGraphResult", "PoseGraphSummary"),
    "inertial.preintegration.imu_factors": ("BiasWalkFactor", "ImuFactor"),
    "inertial.preintegration.motion_excitation": ("Excitation", "excitation"),
    "inertial.preintegration.preintegration": ("Preintegration", "propagate"),
    "inertial.preintegration.repropagation": ("Repropagation",),
    "inertial.tracking.track_images": ("TrackedImages", "track_images"),
    "inertial.tracking.track_recording": ("Tracking",),
    "inertial.two_loops.closure_loop": ("ClosureLoop",),
    "inertial.two_loops.pose_publisher": ("PosePublisher",),
    "inertial.two_loops.window_loop": ("WindowLoop",),
    "inertial.vio.initialize": ("VioStart", "initialize_vio"),
    "inertial.vio.keyframe_record": ("KeyframeRecord",),
    "inertial.vio.landmark_table": ("FrameTracks",),
    "inertial.vio.msckf": ("MsckfUpdate", "TrackRows", "msckf_update", "track_rows"),
    "inertial.vio.odometry": ("OdometryResult", "run_odometry"),
    "inertial.vio.sliding_window": ("SlidingWindow",),
    "inertial.vio.trajectory_comparison": ("TrajectoryError", "compare_trajectories"),
    "inertial.vio.window_frame": ("ImuInterval",),
    "interface.evaluate_options": ("EvaluateOptions",),
    "interface.flight_options": ("FlightOptions",),
    "interface.options": ("SolveOptions",),
    "interface.pose_graph_options": ("PoseGraphOptions",),
    "interface.progress_bar": ("ProgressBar",),
    "interface.scene_options": ("SceneOptions",),
    "interface.summary": ("Summary",),
    "interface.tracking_options": ("TrackingOptions",),
    "interface.triage_options": ("TriageOptions",),
    "interface.window_options": ("WindowOptions",),
    "io.files": ("load", "reprojection_errors", "save"),
    "io.formats.registry": ("Format",),
    "io.pose_files": ("load_poses",),
    "io.sequences.sequence_folder": ("load_sequence", "save_sequence"),
    "io.sequences.trajectory_files": ("Trajectory", "load_trajectory"),
    "judging.triage.cause_words": ("TriageCause",),
    "judging.triage.triage_reports": ("triage",),
    "judging.triage.triage_result": ("Triage",),
    "judging.validation.validate_problem": ("validate",),
    "judging.validation.validation_result": ("ValidatedCandidate", "Validation"),
    "io.source": ("reprojection_errors",),
    "judging.evaluation.check_points": ("CheckPointEvaluation",),
    "judging.evaluation.evaluate_models": ("evaluate",),
    "judging.evaluation.evaluation_result": ("Evaluation",),
    "model.cameras": ("camera_models", "project"),
    "model.pose_graph_arrays": ("PoseGraph",),
    "model.pose_table": ("PoseTable",),
    "model.problem": ("Problem",),
    "model.reprojection": ("ReprojectionError",),
    "model.rolling_shutter": ("RollingShutter",),
    "model.selection": ("Selection",),
    "model.sequence.calibration": ("Calibration",),
    "model.sequence.imu_noise": ("ImuNoise",),
    "model.sequence.imu_samples": ("check_imu_samples",),
    "model.sequence.sequence": ("Sequence",),
    "planning.comparison.compare_methods": ("compare",),
    "planning.comparison.comparison_result": ("Comparison", "read_comparison"),
    "planning.comparison.graph_comparison": ("GraphComparison",),
    "planning.inspection.factor_graph_inspection": ("FactorGraphInspection",),
    "planning.inspection.graph_inspection": ("GraphInspection", "inspect_graph"),
    "planning.inspection.inspection_result": ("Inspection", "MethodInspection"),
    "planning.inspection.pose_graph_inspection": ("PoseGraphInspection",),
    "planning.inspection.problem_inspection": ("inspect",),
    "reports.page": ("report",),
    "reports.saved_report": ("save_report",),
    "solving.colmap_adjustment.bundle_adjustment": ("bundle_adjustment",),
    "solving.constraints.rule_list": ("Constraints",),
    "solving.gauge_freedom": ("GaugeFreedom", "gauge_freedom"),
    "solving.held_out.hold_out": ("hold_out",),
    "solving.result": ("Result",),
    "solving.rounds.filtering": ("Filtered", "filter_observations"),
    "solving.rounds.solve_rounds": ("solve_rounds",),
    "solving.solve": ("solve",),
    "solving.solver": ("Solver",),
    "synthetic.flight.synthetic_flight": ("SyntheticFlight", "synthesize_flight"),
    "synthetic.synthesis": ("SyntheticScene", "synthesize"),
}
"""Modules by the names that they define. Each is imported on first use of a name (PEP 562).

The command line imports this module first and must handle Ctrl-C before slow imports.
"""

_WITHOUT_LIBRARIES = ("_core", "base.paths", "errors")
"""Modules of names that are used without NumPy."""

_MODULES = {
    "constraints": "solving.constraints",
    "figures": "figures",
    "georeference": "georeference",
    "html": "reports.page",
    "losses": "model.losses",
    "pictures": "figures.matplotlib",
    "two_loops": "inertial.two_loops",
    "warning_kinds": "interface.warning_kinds",
}
"""Public modules, with their location in the package."""


class _OtherNames:
    """Finder of modules by public and former names (``import bundle.losses``, old pickles)."""

    @staticmethod
    def find_spec(name: str, *_: object) -> Any:
        if not name.startswith("bundle."):
            return None
        from bundle.base.former_names import spec_of

        return spec_of(name, _MODULES)


class _BelowPublicNames:
    """Finder of submodules of public modules; without it, Python would load them a second time."""

    @staticmethod
    def find_spec(name: str, *_: object) -> Any:
        place = _MODULES.get(name[7:].partition(".")[0]) if name.startswith("bundle.") else None
        is_below = place is not None and not f"{name}.".startswith(f"bundle.{place}.")
        return _OtherNames.find_spec(name) if is_below else None


def __getattr__(name: str) -> Any:
    import importlib

    if name in _MODULES:
        value = importlib.import_module(f"bundle.{_MODULES[name]}")
        globals()[name] = value
        return value
    for module, names in _DEFERRED.items():
        if name in names:
            if module not in _WITHOUT_LIBRARIES:
                from bundle.base import blas_threads

                blas_threads.load_libraries()
            value = getattr(importlib.import_module(f"bundle.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'bundle' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _install_finders() -> None:
    import sys

    sys.meta_path.insert(0, _BelowPublicNames)
    sys.meta_path.append(_OtherNames)


_install_finders()
