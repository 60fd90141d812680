"""Two loops: poses at the IMU rate, independent of the duration of window and graph solves.

A :class:`PosePublisher` answers each IMU sample with a pose and never waits. A :class:`WindowLoop`
and a :class:`ClosureLoop` solve on their own threads. They put results with time stamps into rings,
and the publisher uses the newest. :func:`run_two_loops` replays a sequence through all three.
"""

from bundle.inertial.two_loops.closure_loop import Closure, ClosureLoop, Keyframe, load_closures
from bundle.inertial.two_loops.loop_thread import Ring, deadline_priority
from bundle.inertial.two_loops.pose_publisher import (
    Correction,
    PosePublisher,
    PublishedPose,
    Solution,
    YawMotion,
)
from bundle.inertial.two_loops.replay import (
    LoopStatistics,
    ProcessSolver,
    TwoLoopsResult,
    run_two_loops,
)
from bundle.inertial.two_loops.window_loop import WindowLoop

__all__ = [
    "Closure",
    "ClosureLoop",
    "Correction",
    "Keyframe",
    "LoopStatistics",
    "PosePublisher",
    "ProcessSolver",
    "PublishedPose",
    "Ring",
    "Solution",
    "TwoLoopsResult",
    "WindowLoop",
    "YawMotion",
    "deadline_priority",
    "load_closures",
    "run_two_loops",
]
