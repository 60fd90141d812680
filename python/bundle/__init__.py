"""Bundle adjustment that explains itself: load, refine, save reconstructions."""

from __future__ import annotations

TYPE_CHECKING = False  # as typing.TYPE_CHECKING; importing typing would be slower than this module
if TYPE_CHECKING:
    from typing import Any

_DEFERRED = {
    "_core": "__version__",
    "analysis.diagnosis.chi2_kinds": "Chi2Kind chi2_kinds",
    "analysis.diagnosis.diagnose_problem": "diagnose",
    "analysis.diagnosis.diagnosis_result": "Diagnosis GraphDiagnosis",
    "analysis.statistics.description": "Description describe",
    "analysis.uncertainty.adjoint": (
        "Adjoint Derivatives GaugeWarning NotConvergedWarning adjoint"
    ),
    "analysis.uncertainty.covariance_by_input": "covariance",
    "analysis.uncertainty.covariance_result": "Covariance GraphCovariance",
    "analysis.uncertainty.graph_covariance": "FactorGraphCovariance",
    "analysis.uncertainty.influence": "Influence influence",
    "analysis.uncertainty.measurement_plan": "Plan plan",
    "analysis.uncertainty.reliability": "reliability",
    "analysis.uncertainty.reliability_result": "Reliability",
    "base.paths": "get_include",
    "checking.gradient_report": "GradientReport",
    "editing.camera_sharing": "share_cameras split_cameras",
    "editing.model_change": "CameraModelChange ChangedModels change_camera_model",
    "editing.merge_models": "Merge merge",
    "editing.rig_config": "apply_rig_config",
    "editing.rolling_shutters": "GlobalShutterModel to_global_shutter",
    "errors": "InputError",
    "georeference.alignment": "align",
    "georeference.alignment_result": "Alignment",
    "georeference.attitude_priors": "GravityPrior HeadingPrior OrientationPrior",
    "georeference.control_point": "GroundControlPoint ScaleBar",
    "georeference.vector_priors": "PositionPrior",
    "georeference.velocities": "VelocityPrior",
    "graphs.factors.checks": "check_gradients check_jacobians",
    "graphs.factors.factor_graph": "DigitsLeft FactorGraph GraphResult",
    "graphs.factors.factors": (
        "BetweenFactor FunctionFactor PositionFactor PriorFactor RelativePoseFactor "
        "ReprojectionFactor ScalarPriorFactor"
    ),
    "graphs.factors.image_factors": "DirectionFactor HeadingFactor RotationFactor",
    "graphs.factors.incremental_smoother": "IncrementalSmoother IncrementalUpdate",
    "graphs.factors.linear_prior": "LinearPrior PriorSpectrum SquareRootPrior",
    "graphs.factors.problem_factors": "check_factors",
    "graphs.loops.loop_closing": "LoopClosing LoopClosure",
    "graphs.loops.loop_graph": "close_loops",
    "graphs.pose_graphs.certify": "certify",
    "graphs.pose_graphs.edge_weights": "initial_poses pose_graph_chi2",
    "graphs.pose_graphs.pose_graph_result": (
        "Certificate PoseGraphResult PoseGraphSummary Staircase"
    ),
    "inertial.preintegration.imu_factors": "BiasWalkFactor ImuFactor",
    "inertial.preintegration.preintegration": (
        "Excitation Preintegration Repropagation excitation propagate"
    ),
    "inertial.tracking.track_recording": "TrackedImages Tracking track_images",
    "inertial.two_loops.closure_loop": "ClosureLoop",
    "inertial.two_loops.pose_publisher": "PosePublisher",
    "inertial.two_loops.window_loop": "WindowLoop",
    "inertial.vio.initialize": "VioStart initialize_vio",
    "inertial.vio.keyframe_record": "KeyframeRecord",
    "inertial.vio.landmark_table": "FrameTracks",
    "inertial.vio.msckf": "MsckfUpdate TrackRows msckf_update track_rows",
    "inertial.vio.odometry": "OdometryResult run_odometry",
    "inertial.vio.sliding_window": "SlidingWindow",
    "inertial.vio.trajectory_comparison": "TrajectoryError compare_trajectories",
    "inertial.vio.window_frame": "ImuInterval",
    "interface.judging_options": "EvaluateOptions TriageOptions",
    "interface.options": "SolveOptions",
    "interface.pose_graph_options": "PoseGraphOptions",
    "interface.progress_bar": "ProgressBar",
    "interface.scene_options": "FlightOptions SceneOptions",
    "interface.summary": "Summary",
    "interface.window_options": "TrackingOptions WindowOptions",
    "io.files": "load reprojection_errors save",
    "io.formats.registry": "Format",
    "io.pose_files": "load_poses",
    "io.sequences.sequence_folder": "load_sequence save_sequence",
    "io.sequences.trajectory_files": "Trajectory load_trajectory",
    "judging.evaluation.check_points": "CheckPointEvaluation",
    "judging.evaluation.evaluate_models": "evaluate",
    "judging.evaluation.evaluation_result": "Evaluation",
    "judging.triage.triage_result": "Triage TriageCause",
    "judging.triage.triage_reports": "triage",
    "judging.validation.validate_problem": "validate",
    "judging.validation.validation_result": "ValidatedCandidate Validation",
    "model.cameras": "camera_models project",
    "model.pose_graph_arrays": "PoseGraph",
    "model.pose_table": "PoseTable",
    "model.problem": "Problem",
    "model.residuals": "ReprojectionError",
    "model.rolling_shutter": "RollingShutter",
    "model.selection": "Selection",
    "model.sequence.calibration": "Calibration ImuNoise",
    "model.sequence.sequence": "Sequence check_imu_samples",
    "planning.comparison.compare_methods": "compare",
    "planning.comparison.comparison_result": "Comparison read_comparison",
    "planning.comparison.graph_comparison": "GraphComparison",
    "planning.inspection.elimination_costs": "FactorGraphInspection PoseGraphInspection",
    "planning.inspection.graph_inspection": "GraphInspection inspect_graph",
    "planning.inspection.inspection_result": "Inspection MethodInspection",
    "planning.inspection.problem_inspection": "inspect",
    "reports.page": "report",
    "reports.json_schema": "save_report",
    "solving.colmap_adjustment": "bundle_adjustment",
    "solving.constraints.rule_list": "Constraints",
    "solving.gauge_freedom": "GaugeFreedom gauge_freedom",
    "solving.hold_out": "hold_out",
    "solving.result": "Result",
    "solving.rounds.plan": "Filtered filter_observations",
    "solving.refine_tracks": "refine_tracks",
    "solving.rounds.solve_rounds": "solve_rounds",
    "solving.solve": "solve",
    "solving.solver": "Solver",
    "synthetic.synthetic_flight": "SyntheticFlight synthesize_flight",
    "synthetic.synthesis": "SyntheticScene synthesize",
}
"""Modules with their public names. Each is imported on first use of a name (PEP 562).

The command line imports this module first and must handle Ctrl-C before slow imports.
``tools/public_stub.py`` writes ``__init__.pyi`` for type checkers and editors from this table.
"""
_MODULE_OF = {name: module for module, names in _DEFERRED.items() for name in names.split()}

_WITHOUT_LIBRARIES = ("_core", "base.paths", "errors")
"""Modules of names that are used without NumPy."""

_MODULES = {
    "constraints": "solving.constraints",
    "figures": "figures",
    "georeference": "georeference",
    "html": "reports.page",
    "jax": "analysis.uncertainty.with_jax",
    "losses": "model.losses",
    "pictures": "figures.matplotlib",
    "torch": "analysis.uncertainty.with_torch",
    "two_loops": "inertial.two_loops",
    "warning_kinds": "interface.warning_kinds",
}
"""Public modules, with their location in the package."""

_ELSEWHERE = {"refine": "solve", "optimize": "solve", "adjust": "solve", "read": "load"}
_ELSEWHERE |= {"write": "save", "convert": "save", "info": "describe", "vio": "run_odometry"}
"""Names of this package by other words, such as those of the command line."""

__all__ = sorted({*_MODULES, *_MODULE_OF})  # noqa: PLE0605 (the stub has a list)


class _PublicModules:
    """Finder of public modules and of those below them (``import bundle.losses``).

    It precedes Python's own finders, which would load the modules below a second time.
    """

    @staticmethod
    def find_spec(name: str, *_: object) -> Any:
        place = _MODULES.get(name[7:].partition(".")[0]) if name.startswith("bundle.") else None
        if place is None or f"{name}.".startswith(f"bundle.{place}."):
            return None
        from bundle.base.public_modules import spec_of

        return spec_of(name, _MODULES)


def __getattr__(name: str) -> Any:
    import importlib

    if name in _MODULES:
        value = importlib.import_module(f"bundle.{_MODULES[name]}")
        globals()[name] = value
        return value
    if name not in _MODULE_OF:
        from bundle.errors import nearest

        hint = "" if name.startswith("_") else nearest(name, {n: n for n in __all__} | _ELSEWHERE)
        raise AttributeError(f"module 'bundle' has no attribute {name!r}{hint}")
    module = _MODULE_OF[name]
    if module not in _WITHOUT_LIBRARIES:
        from bundle.base import own_process

        own_process.load_libraries()
    value = getattr(importlib.import_module(f"bundle.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _install_finder() -> None:
    import sys

    sys.meta_path.insert(0, _PublicModules)


_install_finder()
