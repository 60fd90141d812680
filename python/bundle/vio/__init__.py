"""Visual-inertial odometry: sequences, trajectories, and what is estimated from them."""

from bundle.vio.calibration import Calibration
from bundle.vio.initialize import VioStart, initialize_vio
from bundle.vio.keyframe_record import KeyframeRecord
from bundle.vio.landmark_table import FrameTracks
from bundle.vio.odometry import OdometryResult, run_odometry
from bundle.vio.sequence import Sequence
from bundle.vio.sequence_findings import SequenceFinding, sequence_findings
from bundle.vio.sequence_folder import (
    check_sequence_target,
    load_sequence,
    read_sequence,
    refuse_fatal,
    save_sequence,
)
from bundle.vio.sliding_window import SlidingWindow
from bundle.vio.track_csv import read_track_csv
from bundle.vio.trajectory_comparison import (
    TrajectoryError,
    aligned_in_yaw,
    compare_trajectories,
    states_at,
)
from bundle.vio.trajectory_files import (
    Trajectory,
    load_ground_truth,
    load_trajectory,
    load_tum,
    save_ground_truth,
    save_tum,
)
from bundle.vio.window_frame import ImuInterval
from bundle.vio.window_options import WindowOptions

__all__ = [
    "Calibration",
    "FrameTracks",
    "ImuInterval",
    "KeyframeRecord",
    "OdometryResult",
    "Sequence",
    "SequenceFinding",
    "SlidingWindow",
    "Trajectory",
    "TrajectoryError",
    "VioStart",
    "WindowOptions",
    "aligned_in_yaw",
    "check_sequence_target",
    "compare_trajectories",
    "initialize_vio",
    "load_ground_truth",
    "load_sequence",
    "load_trajectory",
    "load_tum",
    "read_sequence",
    "read_track_csv",
    "refuse_fatal",
    "run_odometry",
    "save_ground_truth",
    "save_sequence",
    "save_tum",
    "sequence_findings",
    "states_at",
]
