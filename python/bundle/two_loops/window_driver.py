"""A sliding window as the solve of a window loop, which hands its keyframes to a closure loop.

A slow solve meets several images at its next call: the newest is solved for, the others are left
out, and the samples between go on in its interval.

Closures come at any two times between images that were solved for. With the window's poses A and B
of the keyframes that are nearest to them, and a and b at the times themselves, interpolated, the
closure M of b in the frame of a becomes

    (A^-1 a) M (B^-1 b)^-1,

of keyframe B in the frame of keyframe A: the window is right over fractions of a second, whatever
it has drifted by since. Its information stays as it is.

The motion from keyframe to keyframe gets the sigmas EDGE_TURN and EDGE_SHIFT + EDGE_SHARE of its
length. They weigh the odometry beside closures with sigmas of their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.rigid_motions import inverse_poses, multiply_poses
from bundle.two_loops.closure_loop import Closure, ClosureLoop, Keyframe
from bundle.two_loops.pose_publisher import Solution
from bundle.vio import SlidingWindow, Trajectory, states_at
from bundle.vio.odometry import begin_window, is_sane
from bundle.vio.sequence_images import SequenceImages

__all__ = ["WindowDriver"]

Array = NDArray[np.float64]

EDGE_TURN = np.radians(0.1)
EDGE_SHIFT, EDGE_SHARE = 2e-3, 0.01  # m; of the length


class WindowDriver:
    """Solves images of a sequence on the thread of a :class:`WindowLoop`.

    Args:
        window: not yet started.
        images: of the sequence.
        closures: by the time of their later end.

    Raises:
        InputError: the sequence has no start.
    """

    def __init__(
        self, window: SlidingWindow, images: SequenceImages, closures: tuple[Closure, ...]
    ) -> None:
        self.window, self.images = window, images
        self.start, self.next_image = begin_window(window, images)
        self.stamps = [frame.stamp for frame in window.frames]
        self.states = [frame.state for frame in window.frames]
        self.num_left_out = 0
        self.message = ""
        self.num_outside = 0
        self._keyframes: list[int] = []
        self._closures = list(closures)
        self._graph: ClosureLoop | None = None

    def join(self, graph: ClosureLoop) -> None:
        """Hand keyframes and closures to a loop from now on."""
        self._graph = graph
        for stamp, state in zip(self.stamps, self.states, strict=True):
            self._put_keyframe(stamp, state)

    def solve(self, frames: list[int], deadline: float) -> Solution | None:
        """Solve for the newest of some images; None where the motion is lost."""
        del deadline  # the window has its own budget, within that of the loop
        if self.message:
            return None
        self.num_left_out += len(frames) - 1
        window, images, image = self.window, self.images, frames[-1]
        record = window.add_frame(
            images.stamp(image),
            images.interval(window.frames[-1].stamp, image),
            images.tracks(image, window.options.refine_time_offset),
        )
        newest = window.frames[-1]
        self.stamps.append(newest.stamp)
        self.states.append(newest.state)
        if not is_sane(newest.state):
            seconds = 1e-9 * (newest.stamp - self.stamps[0])
            self.message = f"the motion was lost {seconds:.2f} s after the start"
            return None
        if record is not None and self._graph is not None:
            self._put_keyframe(newest.stamp, newest.state)
            self._put_closures(newest.stamp)
        return Solution(newest.stamp, newest.state)

    @property
    def trajectory(self) -> Trajectory:
        """States of the images when they were solved for."""
        return Trajectory(np.array(self.stamps, np.int64), np.array(self.states))

    @property
    def num_closures_left(self) -> int:
        """Closures whose later end no keyframe has reached."""
        return len(self._closures)

    def _put_keyframe(self, stamp: int, state: Array) -> None:
        assert self._graph is not None
        length = 0.0
        if self._keyframes:
            before = self.states[self.stamps.index(self._keyframes[-1])]
            length = float(np.linalg.norm(state[4:7] - before[4:7]))
        sigmas = np.repeat([EDGE_TURN, EDGE_SHIFT + EDGE_SHARE * length], 3)
        self._graph.put_keyframe(Keyframe(stamp, state[:7], np.diag(sigmas**-2.0)))
        self._keyframes.append(stamp)

    def _put_closures(self, now: int) -> None:
        """Hand over the closures whose later end is not after the newest keyframe."""
        assert self._graph is not None
        while self._closures and max(self._ends(self._closures[0])) <= now:
            closure = self._closures.pop(0)
            moved = self._between_keyframes(closure)
            if moved is None:
                self.num_outside += 1
            else:
                self._graph.put_closure(moved)

    def _between_keyframes(self, closure: Closure) -> Closure | None:
        """Return the closure between its nearest keyframes, None where it is outside or of one."""
        ends = np.array(self._ends(closure), np.int64)
        if ends.min() < self.stamps[0]:
            return None
        places = np.array(self._keyframes, np.int64)
        near = [int(places[np.argmin(np.abs(places - end))]) for end in ends]
        if near[0] == near[1]:
            return None
        at = states_at(self.trajectory, ends)[:, :7]
        keyframes = states_at(self.trajectory, np.array(near, np.int64))[:, :7]
        away = multiply_poses(inverse_poses(keyframes), at)
        measured = np.asarray(closure.measurement)[None]
        moved = multiply_poses(multiply_poses(away[:1], measured), inverse_poses(away[1:]))
        return Closure(near[0], near[1], moved[0], closure.information)

    @staticmethod
    def _ends(closure: Closure) -> tuple[int, int]:
        return int(closure.first_ns), int(closure.second_ns)
