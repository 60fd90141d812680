"""Drives through a road network laid out as a grid.

Roads run along both axes, one every ``pitch`` length units; their crossings are the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = ["drive_laps", "drive_one_way", "waypoints"]

Array = NDArray[np.float64]
Step = tuple[int, int]
_POINTS_PER_CORNER = 12


def drive_laps(rng: np.random.Generator) -> Iterator[Step]:
    """Yield steps between nodes, without end: laps around blocks, each closed and then left.

    The first lap is around one block. Every lap ends by driving again along its first road.
    """
    heading: Step = (1, 0)
    length, width = 1, 1
    while True:
        side = int(rng.choice([-1, 1]))
        for leg in (length, width, length, width):
            yield from [heading] * leg
            heading = _turned(heading, side)
        yield from [heading] * length
        if rng.random() < 0.5:
            heading = _turned(heading, -side)
        length, width = (int(number) for number in rng.integers(1, 4, 2))


def drive_one_way(rng: np.random.Generator) -> Iterator[Step]:
    """Yield steps between nodes, without end, that never come back: a staircase."""
    heading: Step = (1, 0)
    while True:
        yield from [heading] * int(rng.integers(1, 4))
        heading = (heading[1], heading[0])


def waypoints(
    drive: Callable[[np.random.Generator], Iterator[Step]],
    rng: np.random.Generator,
    *,
    pitch: float,
    corner_radius: float,
    spacing: float,
    count: int,
) -> tuple[Array, Array]:
    """Drive with rounded corners.

    Args:
        drive: the steps to take.
        rng: where the drive takes its decisions from.
        pitch: distance between roads.
        corner_radius: where a turn begins before the node, at most half the pitch.
        spacing: distance travelled between waypoints.
        count: number of waypoints.

    Returns:
        Positions (count, 2), and headings (count,) in radians from the x axis.
    """
    # The headings look one and a half steps ahead; a corner shortens the way by 0.6 radii at most.
    needed = (count + 3) * spacing
    nodes: list[Step] = [(0, 0)]
    travelled = 0.0
    for dx, dy in drive(rng):
        nodes.append((nodes[-1][0] + dx, nodes[-1][1] + dy))
        travelled += pitch - 0.6 * corner_radius
        if travelled > needed:
            break
    path = _round_corners(np.array(nodes) * pitch, corner_radius)
    steps = np.diff(path, axis=0)
    distance = np.concatenate([[0.0], np.cumsum(np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2))])

    def at(where: Array) -> Array:
        return np.stack([np.interp(where, distance, path[:, axis]) for axis in range(2)], axis=1)

    where: Array = (np.arange(count, dtype=np.float64) + 0.5) * spacing
    ahead: Array = at(where + 1.5 * spacing) - at(where - 0.5 * spacing)
    return at(where), np.arctan2(ahead[:, 1], ahead[:, 0])


def _turned(heading: Step, side: int) -> Step:
    return (-side * heading[1], side * heading[0])


def _round_corners(nodes: Array, radius: float) -> Array:
    """Return a polyline in which quadratic Bezier curves replace the corners."""
    before = nodes[1:-1] + radius * _unit(nodes[:-2] - nodes[1:-1])
    after = nodes[1:-1] + radius * _unit(nodes[2:] - nodes[1:-1])
    t = np.linspace(0.0, 1.0, _POINTS_PER_CORNER)[None, :, None]
    curves = (
        (1 - t) ** 2 * before[:, None] + 2 * t * (1 - t) * nodes[1:-1, None] + t**2 * after[:, None]
    )
    return np.concatenate([nodes[:1], curves.reshape(-1, 2), nodes[-1:]])


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(vectors[:, :1] ** 2 + vectors[:, 1:] ** 2)
