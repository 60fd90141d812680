"""Public and former names of modules, for ``import bundle.losses`` and pickles of old versions.

A pickle contains the module name of each class. With this table, pickles can be loaded that were
written before the modules moved to their present folders.
"""

from __future__ import annotations

import importlib
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

FORMER = {
    "camera_bounds": "solving.constraints.camera_bounds",
    "camera_changes": "solving.camera_changes",
    "camera_edits.camera_sharing": "editing.cameras.camera_sharing",
    "camera_edits.edit_record": "editing.cameras.edit_record",
    "camera_edits.model_change": "editing.cameras.model_change",
    "cameras": "model.cameras",
    "comparison.compare_methods": "planning.comparison.compare_methods",
    "comparison.comparison_result": "planning.comparison.comparison_result",
    "comparison.graph_comparison": "planning.comparison.graph_comparison",
    "comparison.method": "planning.comparison.method",
    "constraint_record": "solving.constraints.constraint_record",
    "constraints.applied": "solving.constraints.applied",
    "constraints.rule_list": "solving.constraints.rule_list",
    "constraints.rules": "solving.constraints.rules",
    "diagnosis.conditioning": "analysis.diagnosis.diagnosis_result",
    "diagnosis.diagnose_problem": "analysis.diagnosis.diagnose_problem",
    "diagnosis.diagnosis_result": "analysis.diagnosis.diagnosis_result",
    "diagnosis.graph_diagnosis": "analysis.diagnosis.diagnosis_result",
    "files": "io.files",
    "filters.msckf": "inertial.vio.msckf",
    "filters.track_linearization": "inertial.vio.msckf",
    "free_degrees": "solving.gauge_freedom",
    "graph.digits": "graphs.factors.factor_graph",
    "graph.factor_check": "graphs.factors.factor_check",
    "graph.factor_graph": "graphs.factors.factor_graph",
    "graph.factors": "graphs.factors.factors",
    "graph.function_factor": "graphs.factors.factors",
    "graph.graph_options": "interface.options",
    "graph.graph_result": "graphs.factors.factor_graph",
    "graph.incremental_smoother": "graphs.factors.incremental_smoother",
    "graph.linear_prior": "graphs.factors.linear_prior",
    "graph.problem_factors": "graphs.factors.problem_factors",
    "graph.spectrum": "graphs.factors.linear_prior",
    "graph.square_root_prior": "graphs.factors.linear_prior",
    "graph.variables": "graphs.factors.variables",
    "headers": "base.paths",
    "html": "reports.page",
    "inertial.imu_factors": "inertial.preintegration.imu_factors",
    "inertial.imu_noise": "model.sequence.imu_noise",
    "inertial.imu_samples": "model.sequence.imu_samples",
    "inertial.motion_excitation": "inertial.preintegration.motion_excitation",
    "inertial.preintegration": "inertial.preintegration.preintegration",
    "inertial.propagation": "inertial.preintegration.preintegration",
    "inertial.repropagation": "inertial.preintegration.repropagation",
    "inspection.elimination": "planning.inspection.graph_inspection",
    "inspection.graph_inspection": "planning.inspection.graph_inspection",
    "inspection.inspection_result": "planning.inspection.inspection_result",
    "inspection.methods": "planning.inspection.methods",
    "inspection.pose_graph_inspection": "planning.inspection.pose_graph_inspection",
    "inspection.problem_inspection": "planning.inspection.problem_inspection",
    "inspection.problem_pattern": "planning.inspection.problem_pattern",
    "inspection.rank_limit": "planning.inspection.rank_prediction",
    "inspection.rank_prediction": "planning.inspection.rank_prediction",
    "inspection.rates": "planning.inspection.rates",
    "inspection.schur_counts": "planning.inspection.problem_needs",
    "io.problem_source": "model.pycolmap.problem_source",
    "loops.loop_closing": "graphs.loops.loop_closing",
    "loops.loop_graph": "graphs.loops.loop_graph",
    "merging.joining": "editing.merging.joining",
    "merging.merge_models": "editing.merging.merge_models",
    "merging.merge_result": "editing.merging.merge_result",
    "options": "interface.options",
    "pose_graph.consistency": "graphs.pose_graphs.consistency",
    "pose_graph.joints": "graphs.pose_graphs.joints",
    "pose_graph.odometry_chain": "graphs.pose_graphs.consistency",
    "pose_graph.pose_graph_arrays": "model.pose_graph_arrays",
    "pose_graph.pose_graph_result": "graphs.pose_graphs.pose_graph_result",
    "pose_graph.solve_pose_graph": "graphs.pose_graphs.solve_pose_graph",
    "pose_graph.starts": "model.starts",
    "pose_graph_options": "interface.pose_graph_options",
    "problem": "model.problem",
    "process_record": "interface.process_record",
    "reprojection": "model.reprojection",
    "restrictions": "solving.constraints.restrictions",
    "result": "solving.result",
    "rig_config": "editing.rig_config",
    "round_record": "solving.round_record",
    "rounds.adjust_and_filter": "solving.rounds.solve_rounds",
    "rounds.filtering": "solving.rounds.filtering",
    "rounds.local_part": "solving.rounds.local_part",
    "rounds.round_options": "interface.round_options",
    "sensor_changes": "solving.sensor_changes",
    "solve_record": "interface.solve_record",
    "solver": "solving.solver",
    "statistics.covisibility": "analysis.statistics.covisibility",
    "statistics.depths": "analysis.statistics.depths",
    "statistics.description": "analysis.statistics.description",
    "statistics.lenses": "analysis.statistics.suspicions",
    "statistics.rig_summary": "analysis.statistics.rig_summary",
    "statistics.suspicions": "analysis.statistics.suspicions",
    "summary": "interface.summary",
    "synthetic.flight_options": "interface.flight_options",
    "synthetic.scene_options": "interface.scene_options",
    "termination": "interface.termination",
    "two_loops.closure_loop": "inertial.two_loops.closure_loop",
    "two_loops.pose_publisher": "inertial.two_loops.pose_publisher",
    "two_loops.replay": "inertial.two_loops.replay",
    "two_loops.window_loop": "inertial.two_loops.window_loop",
    "two_loops.yaw_motion": "inertial.two_loops.yaw_motion",
    "uncertainty.compute_covariance": "analysis.uncertainty.compute_covariance",
    "uncertainty.covariance_choices": "interface.covariance_options",
    "uncertainty.covariance_result": "analysis.uncertainty.covariance_result",
    "uncertainty.graph_covariance": "analysis.uncertainty.graph_covariance",
    "vio.calibration": "model.sequence.calibration",
    "vio.initialize": "inertial.vio.initialize",
    "vio.keyframe_record": "inertial.vio.keyframe_record",
    "vio.landmark_table": "inertial.vio.landmark_table",
    "vio.marginal_prior": "inertial.vio.marginal_prior",
    "vio.odometry": "inertial.vio.odometry",
    "vio.sequence": "model.sequence.sequence",
    "vio.sequence_findings": "model.sequence.sequence_findings",
    "vio.sequence_folder": "io.sequences.sequence_folder",
    "vio.sequence_statistics": "inertial.vio.sequence_statistics",
    "vio.sliding_window": "inertial.vio.sliding_window",
    "vio.trajectory_comparison": "inertial.vio.trajectory_comparison",
    "vio.trajectory_files": "io.sequences.trajectory_files",
    "vio.window_frame": "inertial.vio.window_frame",
    "vio.window_options": "interface.window_options",
    "worst_images": "model.worst_images",
}
"""Former modules of public classes and of their attributes, without the package's name."""


def spec_of(name: str, public_modules: dict[str, str]) -> ModuleSpec | None:
    """Return the spec of a module by its public or former name; None for an unknown name.

    Args:
        name: module name, as in an import.
        public_modules: location of each public module, without the package's name.
    """
    short = name.removeprefix("bundle.")
    place = public_modules.get(short) or FORMER.get(short)
    public, _, below = short.partition(".")
    if place is None and below and public in public_modules:
        place = f"{public_modules[public]}.{below}"
        if find_spec(f"bundle.{place}") is None:
            return None
    if place is not None:
        return ModuleSpec(name, _SameModule(f"bundle.{place}"))
    if any(former.startswith(f"{short}.") for former in FORMER):  # package of a former module
        return ModuleSpec(name, _EmptyPackage(), is_package=True)
    return None


class _SameModule(Loader):
    """Loader of a module under another name."""

    def __init__(self, place: str) -> None:
        self.place = place

    def create_module(self, _spec: ModuleSpec) -> ModuleType:
        """Return the module itself."""
        module = importlib.import_module(self.place)
        self.own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own spec, which the import system replaced."""
        module.__spec__ = self.own


class _EmptyPackage(Loader):
    """Loader of a package that contains only former modules."""

    def create_module(self, _spec: ModuleSpec) -> None:
        """Return None, so that the import system creates the module."""

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing."""
