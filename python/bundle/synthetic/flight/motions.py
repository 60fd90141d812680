"""Motions of a flight: control points of position and of yaw, pitch, roll over time.

The body's x axis points ahead, y to the left, z up; its rotation is R = Rz(yaw) Ry(pitch) Rx(roll),
with pitch positive nose down. A motion stands still at first, and speeds up over some seconds, so
that no spline has to jump.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.synthetic.flight.uniform_spline import control_times

__all__ = ["SPACING", "Surroundings", "control_points", "surroundings"]

Array = NDArray[np.float64]

SPACING = 0.1  # s between knots
RAMP = 2.0  # s from rest to full motion
ROOM = np.array([12.0, 12.0, 5.0])  # m, centred at the origin but for the floor at 0
ROOM_POINTS = 3000
LOOP_RADIUS, LOOP_SPEED = 3.5, 1.5
MOTORWAY_SPEED, MOTORWAY_RAMP, MOTORWAY_WEAVING = 30.0, 10.0, 15.0  # m/s, s, s
ROAD_POINTS_PER_METRE = 4.0
HOVER_AFTER, HOVER_FADE, HOVER_DRIFT = 8.0, 3.0, 0.002  # s, s, share that remains


class Surroundings(NamedTuple):
    """Points (n, 3) sorted by x, and how far from the camera they are seen: near, far [m]."""

    points: Array
    near: float
    far: float


def control_points(motion: str, duration: float, rest: float, rng: np.random.Generator) -> Array:
    """Return control points (m, 6): x y z [m], yaw pitch roll [rad]."""
    time = np.maximum(control_times(duration, SPACING) - rest, 0.0)
    start = np.clip(time / RAMP, 0, 1)
    start = start**2 * (3 - 2 * start)
    if motion == "loop":
        angle = _distance(time, LOOP_SPEED, RAMP) / LOOP_RADIUS
        path = np.zeros((len(time), 6))
        path[:, 0] = LOOP_RADIUS * np.cos(angle)
        path[:, 1] = LOOP_RADIUS * np.sin(angle)
        path[:, 2] = 2.0 + 0.4 * np.sin(0.6 * time) * start
        path[:, 3] = angle + np.pi / 2
        shake = _wander(time, [0.05, 0.05, 0.05, 0.05, 0.06, 0.08], 0.4, 1.0, rng)
        return path + start[:, None] * shake
    if motion == "motorway":
        path = np.zeros((len(time), 6))
        path[:, 0] = _distance(time, MOTORWAY_SPEED, MOTORWAY_RAMP)
        path[:, 2] = 1.5
        weaving = np.clip((MOTORWAY_WEAVING - time) / RAMP, 0, 1)
        weaving = start * weaving**2 * (3 - 2 * weaving)
        shake = _wander(time, [0, 0.5, 0.05, 0.03, 0.01, 0.02], 0.2, 0.7, rng)
        return path + weaving[:, None] * shake
    path = np.tile([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], (len(time), 1))
    slow = _wander(time, [1.6, 1.6, 0.4, 0.8, 0.1, 0.1], 0.05, 0.25, rng)
    shake = _wander(time, [0.05, 0.05, 0.05, 0.05, 0.06, 0.08], 0.4, 1.0, rng)
    wander = start[:, None] * (slow + shake)
    if motion == "hover":
        fade = np.clip((HOVER_AFTER + HOVER_FADE - time) / HOVER_FADE, 0, 1)
        fade = fade**2 * (3 - 2 * fade)
        wander *= np.maximum(fade, HOVER_DRIFT)[:, None]
    if motion == "rotation_only":
        wander[:, :3] = 0
    return path + wander


def surroundings(motion: str, control: Array, rng: np.random.Generator) -> Surroundings:
    """Return the points that the camera of a motion sees."""
    if motion == "motorway":
        length = control[:, 0].max() + 150.0
        count = int(length * ROAD_POINTS_PER_METRE)
        side = np.where(rng.random(count) < 0.5, -1.0, 1.0)
        points = np.column_stack(
            [
                rng.uniform(-5.0, length, count),
                side * rng.uniform(6.0, 25.0, count),
                rng.uniform(0.0, 8.0, count),
            ]
        )
        return Surroundings(points[np.argsort(points[:, 0])], 4.0, 80.0)
    points = rng.uniform(-0.5, 0.5, (ROOM_POINTS, 3)) * ROOM
    areas = np.array([ROOM[1] * ROOM[2], ROOM[0] * ROOM[2], ROOM[0] * ROOM[1]])
    axis = rng.choice(3, ROOM_POINTS, p=areas / areas.sum())
    rows = np.arange(ROOM_POINTS)
    points[rows, axis] = np.where(rng.random(ROOM_POINTS) < 0.5, -0.5, 0.5) * ROOM[axis]
    points[:, 2] += ROOM[2] / 2
    return Surroundings(points[np.argsort(points[:, 0])], 0.5, 30.0)


def _distance(time: Array, speed: float, ramp: float) -> Array:
    """Return how far one has come who speeds up evenly over `ramp` seconds."""
    result: Array = np.where(time < ramp, speed * time**2 / (2 * ramp), speed * (time - ramp / 2))
    return result


def _wander(
    time: Array, sizes: list[float], slowest: float, fastest: float, rng: np.random.Generator
) -> Array:
    """Return sums of three sine waves for each size, of frequencies in Hz between the bounds."""
    size = np.array(sizes)
    frequency = rng.uniform(slowest, fastest, (3, len(size)))
    phase = rng.uniform(0, 2 * np.pi, (3, len(size)))
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase)
    result: Array = size * waves.sum(axis=1) / np.sqrt(3)
    return result
