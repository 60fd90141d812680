"""Two loops: poses at the rate of the IMU, whatever a window and a pose graph behind it take.

A :class:`PosePublisher` answers each IMU sample with a pose and never waits. A
:class:`WindowLoop` and a :class:`ClosureLoop` solve on threads of their own and leave dated results
in rings, of which the publisher takes the newest.
"""

from bundle.two_loops.closure_loop import Closure, ClosureLoop, Keyframe
from bundle.two_loops.pose_publisher import PosePublisher, PublishedPose, Solution
from bundle.two_loops.ring import Ring
from bundle.two_loops.window_loop import WindowLoop
from bundle.two_loops.yaw_motion import Correction, YawMotion

__all__ = [
    "Closure",
    "ClosureLoop",
    "Correction",
    "Keyframe",
    "PosePublisher",
    "PublishedPose",
    "Ring",
    "Solution",
    "WindowLoop",
    "YawMotion",
]
