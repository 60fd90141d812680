"""Bundle adjustment that explains itself: load, refine, save reconstructions.

Written by tools/public_stub.py; do not edit.
"""

from bundle import figures as figures
from bundle import georeference as georeference
from bundle._core import __version__ as __version__
from bundle.analysis.diagnosis.chi2_kinds import Chi2Kind as Chi2Kind
from bundle.analysis.diagnosis.chi2_kinds import chi2_kinds as chi2_kinds
from bundle.analysis.diagnosis.diagnose_problem import diagnose as diagnose
from bundle.analysis.diagnosis.diagnosis_result import Diagnosis as Diagnosis
from bundle.analysis.diagnosis.diagnosis_result import GraphDiagnosis as GraphDiagnosis
from bundle.analysis.statistics.description import Description as Description
from bundle.analysis.statistics.description import describe as describe
from bundle.analysis.uncertainty import with_jax as jax
from bundle.analysis.uncertainty import with_torch as torch
from bundle.analysis.uncertainty.adjoint import Adjoint as Adjoint
from bundle.analysis.uncertainty.adjoint import Derivatives as Derivatives
from bundle.analysis.uncertainty.adjoint import GaugeWarning as GaugeWarning
from bundle.analysis.uncertainty.adjoint import NotConvergedWarning as NotConvergedWarning
from bundle.analysis.uncertainty.adjoint import adjoint as adjoint
from bundle.analysis.uncertainty.covariance_by_input import covariance as covariance
from bundle.analysis.uncertainty.covariance_result import Covariance as Covariance
from bundle.analysis.uncertainty.covariance_result import GraphCovariance as GraphCovariance
from bundle.analysis.uncertainty.graph_covariance import FactorGraphCovariance as FactorGraphCovariance
from bundle.analysis.uncertainty.influence import Influence as Influence
from bundle.analysis.uncertainty.influence import influence as influence
from bundle.analysis.uncertainty.measurement_plan import Plan as Plan
from bundle.analysis.uncertainty.measurement_plan import plan as plan
from bundle.analysis.uncertainty.reliability import reliability as reliability
from bundle.analysis.uncertainty.reliability_result import Reliability as Reliability
from bundle.base.paths import get_include as get_include
from bundle.checking.gradient_report import GradientReport as GradientReport
from bundle.editing.camera_sharing import share_cameras as share_cameras
from bundle.editing.camera_sharing import split_cameras as split_cameras
from bundle.editing.merge_models import Merge as Merge
from bundle.editing.merge_models import merge as merge
from bundle.editing.model_change import CameraModelChange as CameraModelChange
from bundle.editing.model_change import ChangedModels as ChangedModels
from bundle.editing.model_change import change_camera_model as change_camera_model
from bundle.editing.rig_config import apply_rig_config as apply_rig_config
from bundle.editing.rolling_shutters import GlobalShutterModel as GlobalShutterModel
from bundle.editing.rolling_shutters import to_global_shutter as to_global_shutter
from bundle.errors import InputError as InputError
from bundle.figures import matplotlib as pictures
from bundle.georeference.alignment import align as align
from bundle.georeference.alignment_result import Alignment as Alignment
from bundle.georeference.attitude_priors import GravityPrior as GravityPrior
from bundle.georeference.attitude_priors import HeadingPrior as HeadingPrior
from bundle.georeference.attitude_priors import OrientationPrior as OrientationPrior
from bundle.georeference.control_point import GroundControlPoint as GroundControlPoint
from bundle.georeference.control_point import ScaleBar as ScaleBar
from bundle.georeference.vector_priors import PositionPrior as PositionPrior
from bundle.georeference.velocities import VelocityPrior as VelocityPrior
from bundle.graphs.factors.checks import check_gradients as check_gradients
from bundle.graphs.factors.checks import check_jacobians as check_jacobians
from bundle.graphs.factors.factor_graph import DigitsLeft as DigitsLeft
from bundle.graphs.factors.factor_graph import FactorGraph as FactorGraph
from bundle.graphs.factors.factor_graph import GraphResult as GraphResult
from bundle.graphs.factors.factors import BetweenFactor as BetweenFactor
from bundle.graphs.factors.factors import FunctionFactor as FunctionFactor
from bundle.graphs.factors.factors import PositionFactor as PositionFactor
from bundle.graphs.factors.factors import PriorFactor as PriorFactor
from bundle.graphs.factors.factors import RelativePoseFactor as RelativePoseFactor
from bundle.graphs.factors.factors import ReprojectionFactor as ReprojectionFactor
from bundle.graphs.factors.factors import ScalarPriorFactor as ScalarPriorFactor
from bundle.graphs.factors.image_factors import DirectionFactor as DirectionFactor
from bundle.graphs.factors.image_factors import HeadingFactor as HeadingFactor
from bundle.graphs.factors.image_factors import RotationFactor as RotationFactor
from bundle.graphs.factors.incremental_smoother import IncrementalSmoother as IncrementalSmoother
from bundle.graphs.factors.incremental_smoother import IncrementalUpdate as IncrementalUpdate
from bundle.graphs.factors.linear_prior import LinearPrior as LinearPrior
from bundle.graphs.factors.linear_prior import PriorSpectrum as PriorSpectrum
from bundle.graphs.factors.linear_prior import SquareRootPrior as SquareRootPrior
from bundle.graphs.factors.problem_factors import check_factors as check_factors
from bundle.graphs.loops.loop_closing import LoopClosing as LoopClosing
from bundle.graphs.loops.loop_closing import LoopClosure as LoopClosure
from bundle.graphs.loops.loop_graph import close_loops as close_loops
from bundle.graphs.pose_graphs.certify import certify as certify
from bundle.graphs.pose_graphs.edge_weights import initial_poses as initial_poses
from bundle.graphs.pose_graphs.edge_weights import pose_graph_chi2 as pose_graph_chi2
from bundle.graphs.pose_graphs.pose_graph_result import Certificate as Certificate
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult as PoseGraphResult
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphSummary as PoseGraphSummary
from bundle.graphs.pose_graphs.pose_graph_result import Staircase as Staircase
from bundle.inertial import two_loops as two_loops
from bundle.inertial.preintegration.imu_factors import BiasWalkFactor as BiasWalkFactor
from bundle.inertial.preintegration.imu_factors import ImuFactor as ImuFactor
from bundle.inertial.preintegration.preintegration import Excitation as Excitation
from bundle.inertial.preintegration.preintegration import Preintegration as Preintegration
from bundle.inertial.preintegration.preintegration import Repropagation as Repropagation
from bundle.inertial.preintegration.preintegration import excitation as excitation
from bundle.inertial.preintegration.preintegration import propagate as propagate
from bundle.inertial.tracking.track_recording import TrackedImages as TrackedImages
from bundle.inertial.tracking.track_recording import Tracking as Tracking
from bundle.inertial.tracking.track_recording import track_images as track_images
from bundle.inertial.two_loops.closure_loop import ClosureLoop as ClosureLoop
from bundle.inertial.two_loops.pose_publisher import PosePublisher as PosePublisher
from bundle.inertial.two_loops.window_loop import WindowLoop as WindowLoop
from bundle.inertial.vio.initialize import VioStart as VioStart
from bundle.inertial.vio.initialize import initialize_vio as initialize_vio
from bundle.inertial.vio.keyframe_record import KeyframeRecord as KeyframeRecord
from bundle.inertial.vio.landmark_table import FrameTracks as FrameTracks
from bundle.inertial.vio.msckf import MsckfUpdate as MsckfUpdate
from bundle.inertial.vio.msckf import TrackRows as TrackRows
from bundle.inertial.vio.msckf import msckf_update as msckf_update
from bundle.inertial.vio.msckf import track_rows as track_rows
from bundle.inertial.vio.odometry import OdometryResult as OdometryResult
from bundle.inertial.vio.odometry import run_odometry as run_odometry
from bundle.inertial.vio.sliding_window import SlidingWindow as SlidingWindow
from bundle.inertial.vio.trajectory_comparison import TrajectoryError as TrajectoryError
from bundle.inertial.vio.trajectory_comparison import compare_trajectories as compare_trajectories
from bundle.inertial.vio.window_frame import ImuInterval as ImuInterval
from bundle.interface import warning_kinds as warning_kinds
from bundle.interface.judging_options import EvaluateOptions as EvaluateOptions
from bundle.interface.judging_options import TriageOptions as TriageOptions
from bundle.interface.options import SolveOptions as SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions as PoseGraphOptions
from bundle.interface.progress_bar import ProgressBar as ProgressBar
from bundle.interface.scene_options import FlightOptions as FlightOptions
from bundle.interface.scene_options import SceneOptions as SceneOptions
from bundle.interface.summary import Summary as Summary
from bundle.interface.window_options import TrackingOptions as TrackingOptions
from bundle.interface.window_options import WindowOptions as WindowOptions
from bundle.io.files import load as load
from bundle.io.files import reprojection_errors as reprojection_errors
from bundle.io.files import save as save
from bundle.io.formats.registry import Format as Format
from bundle.io.pose_files import load_poses as load_poses
from bundle.io.sequences.sequence_folder import load_sequence as load_sequence
from bundle.io.sequences.sequence_folder import save_sequence as save_sequence
from bundle.io.sequences.trajectory_files import Trajectory as Trajectory
from bundle.io.sequences.trajectory_files import load_trajectory as load_trajectory
from bundle.judging.evaluation.check_points import CheckPointEvaluation as CheckPointEvaluation
from bundle.judging.evaluation.evaluate_models import evaluate as evaluate
from bundle.judging.evaluation.evaluation_result import Evaluation as Evaluation
from bundle.judging.triage.triage_reports import triage as triage
from bundle.judging.triage.triage_result import Triage as Triage
from bundle.judging.triage.triage_result import TriageCause as TriageCause
from bundle.judging.validation.validate_problem import validate as validate
from bundle.judging.validation.validation_result import ValidatedCandidate as ValidatedCandidate
from bundle.judging.validation.validation_result import Validation as Validation
from bundle.model import losses as losses
from bundle.model.cameras import camera_models as camera_models
from bundle.model.cameras import project as project
from bundle.model.pose_graph_arrays import PoseGraph as PoseGraph
from bundle.model.pose_table import PoseTable as PoseTable
from bundle.model.problem import Problem as Problem
from bundle.model.residuals import ReprojectionError as ReprojectionError
from bundle.model.rolling_shutter import RollingShutter as RollingShutter
from bundle.model.selection import Selection as Selection
from bundle.model.sequence.calibration import Calibration as Calibration
from bundle.model.sequence.calibration import ImuNoise as ImuNoise
from bundle.model.sequence.sequence import Sequence as Sequence
from bundle.model.sequence.sequence import check_imu_samples as check_imu_samples
from bundle.planning.comparison.compare_methods import compare as compare
from bundle.planning.comparison.comparison_result import Comparison as Comparison
from bundle.planning.comparison.comparison_result import read_comparison as read_comparison
from bundle.planning.comparison.graph_comparison import GraphComparison as GraphComparison
from bundle.planning.inspection.elimination_costs import FactorGraphInspection as FactorGraphInspection
from bundle.planning.inspection.elimination_costs import PoseGraphInspection as PoseGraphInspection
from bundle.planning.inspection.graph_inspection import GraphInspection as GraphInspection
from bundle.planning.inspection.graph_inspection import inspect_graph as inspect_graph
from bundle.planning.inspection.inspection_result import Inspection as Inspection
from bundle.planning.inspection.inspection_result import MethodInspection as MethodInspection
from bundle.planning.inspection.problem_inspection import inspect as inspect
from bundle.reports import page as html
from bundle.reports.json_schema import save_report as save_report
from bundle.reports.page import report as report
from bundle.solving import constraints as constraints
from bundle.solving.colmap_adjustment import bundle_adjustment as bundle_adjustment
from bundle.solving.constraints.rule_list import Constraints as Constraints
from bundle.solving.gauge_freedom import GaugeFreedom as GaugeFreedom
from bundle.solving.gauge_freedom import gauge_freedom as gauge_freedom
from bundle.solving.hold_out import hold_out as hold_out
from bundle.solving.refine_tracks import refine_tracks as refine_tracks
from bundle.solving.result import Result as Result
from bundle.solving.rounds.plan import Filtered as Filtered
from bundle.solving.rounds.plan import filter_observations as filter_observations
from bundle.solving.rounds.solve_rounds import solve_rounds as solve_rounds
from bundle.solving.solve import solve as solve
from bundle.solving.solver import Solver as Solver
from bundle.synthetic.synthesis import SyntheticScene as SyntheticScene
from bundle.synthetic.synthesis import synthesize as synthesize
from bundle.synthetic.synthetic_flight import SyntheticFlight as SyntheticFlight
from bundle.synthetic.synthetic_flight import synthesize_flight as synthesize_flight

__all__ = [
    "Adjoint",
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
    "Derivatives",
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
    "GaugeWarning",
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
    "Influence",
    "InputError",
    "Inspection",
    "KeyframeRecord",
    "LinearPrior",
    "LoopClosing",
    "LoopClosure",
    "Merge",
    "MethodInspection",
    "MsckfUpdate",
    "NotConvergedWarning",
    "OdometryResult",
    "OrientationPrior",
    "Plan",
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
    "Reliability",
    "ReprojectionError",
    "ReprojectionFactor",
    "Repropagation",
    "Result",
    "RollingShutter",
    "RotationFactor",
    "ScalarPriorFactor",
    "ScaleBar",
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
    "adjoint",
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
    "influence",
    "initial_poses",
    "initialize_vio",
    "inspect",
    "inspect_graph",
    "jax",
    "load",
    "load_poses",
    "load_sequence",
    "load_trajectory",
    "losses",
    "merge",
    "msckf_update",
    "pictures",
    "plan",
    "pose_graph_chi2",
    "project",
    "propagate",
    "read_comparison",
    "refine_tracks",
    "reliability",
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
    "torch",
    "track_images",
    "track_rows",
    "triage",
    "two_loops",
    "validate",
    "warning_kinds",
]
