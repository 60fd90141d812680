"""Drive of a vehicle with a forward-looking camera through a town of square blocks.

Points are on facades (many of them at the corners of windows), on the ground, and on objects on the
pavement. Blocks occlude points behind them. A point is observed over a run of consecutive images.
Covisibility is therefore banded, except for places that the drive revisits.

Length unit: metre; z is up; the road is at z = 0.

Roads form a grid. They run along both axes with a distance of ``pitch`` length units. Their
crossings are the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from bundle.interface.scene_options import SceneOptions
from bundle.model.rigid_motions import look_along
from bundle.synthetic.scene import Images, Pairs, Points, Scene

Array = NDArray[np.float64]
Step = tuple[int, int]
_POINTS_PER_CORNER = 12


def drive_laps(rng: np.random.Generator) -> Iterator[Step]:
    """Yield an endless sequence of steps between nodes: laps around blocks, one after the other.

    The first lap goes around one block. Every lap is closed: at its end it repeats its first road.
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
    """Yield an endless sequence of steps between nodes without revisits: a staircase."""
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
    """Return positions and headings of a drive with rounded corners.

    ``corner_radius``: distance from the node at which a turn begins, at most half the pitch.

    Returns:
        Positions (count, 2), and headings (count,) in radians from the x axis.
    """
    # Headings need 1.5 further steps. A corner shortens the path by at most 0.6 radii.
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
    """Return the polyline with its corners replaced by quadratic Bezier curves."""
    before = nodes[1:-1] + radius * _unit(nodes[:-2] - nodes[1:-1])
    after = nodes[1:-1] + radius * _unit(nodes[2:] - nodes[1:-1])
    t = np.linspace(0.0, 1.0, _POINTS_PER_CORNER)[None, :, None]
    curves = (
        (1 - t) ** 2 * before[:, None] + 2 * t * (1 - t) * nodes[1:-1, None] + t**2 * after[:, None]
    )
    return np.concatenate([nodes[:1], curves.reshape(-1, 2), nodes[-1:]])


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(vectors[:, :1] ** 2 + vectors[:, 1:] ** 2)


ROAD_WIDTH = 11.0  # from facade to facade
CAMERA_HEIGHT = 1.9
FACADE_REACH, GROUND_REACH, FURNITURE_REACH = 42.0, 20.0, 28.0
FACADE_SHARE, GROUND_SHARE = 0.7, 0.2
# Distance over which a point at the roadside stays in view. It determines the spacing of images.
VIEW_LENGTH = 30.0
FOCAL = 0.8


class Street(Scene):
    """Scene of this kind; see the module docstring."""

    min_cosine = 0.07

    def __init__(self, rng: np.random.Generator, options: SceneOptions) -> None:
        count = options.num_images
        self.spacing = float(np.clip(VIEW_LENGTH / (2.4 * options.wanted_track_length), 0.3, 3.5))
        # Short drives get small blocks, so that they also turn and close a lap (4 block lengths).
        self.pitch = float(np.clip(count * self.spacing / 4.4, 20.0, 60.0))
        # Extra distance for lines of sight that graze a facade.
        self.blocks = (self.pitch, 0.5 * ROAD_WIDTH + 0.6)
        self._block_heights = rng.uniform(6.0, 18.0, 512)
        where, heading = waypoints(
            drive_laps if options.loop_closure else drive_one_way,
            rng,
            pitch=self.pitch,
            corner_radius=6.0,
            spacing=self.spacing,
            count=count,
        )
        heading = heading + _wander(rng, count, 0.02)
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        # The vehicle drives on the right.
        where = where + left * (_wander(rng, count, 0.3) - 1.5)[:, None]
        height = CAMERA_HEIGHT + _wander(rng, count, 0.04)
        pitch = 0.02 + _wander(rng, count, 0.012)
        forward = np.concatenate([ahead, -np.tan(pitch)[:, None]], axis=1)
        centers = np.concatenate([where, height[:, None]], axis=1)
        self.images = Images(
            centers=centers,
            rotations=look_along(forward, _wander(rng, count, 0.01)),
            focal=np.full(count, FOCAL),
            sizes=np.tile(np.array(options.image_size, dtype=np.int64), (count, 1)),
            richness=np.ones(count),
            ball_centers=centers + 0.5 * FACADE_REACH * np.append(ahead, 0 * height[:, None], 1),
            ball_radii=np.full(count, 0.6 * FACADE_REACH),
        )
        self._heading = heading

    def draw_points(self, rng: np.random.Generator, count: int) -> Points:
        """Draw points near the view of images, and move them onto the nearest suitable surface."""
        image = rng.integers(0, len(self._heading), count)
        bearing = self._heading[image] + rng.normal(0.0, 0.3, count)
        distance = rng.uniform(5.0, 36.0, count)
        xy = self.images.centers[image, :2] + distance[:, None] * np.stack(
            [np.cos(bearing), np.sin(bearing)], axis=1
        )
        kind = rng.random(count)
        is_facade = kind < FACADE_SHARE
        is_ground = (kind >= FACADE_SHARE) & (kind < FACADE_SHARE + GROUND_SHARE)
        on_facade, normals, is_on = self._onto_facades(rng, xy)
        positions = np.empty((count, 3))
        positions[:, :2] = np.where(is_facade[:, None], on_facade, xy)
        height = self._window_height(rng, self._height_of_block(on_facade - normals[:, :2]))
        positions[:, 2] = np.where(is_facade, height, rng.uniform(0.1, 3.5, count))
        positions[is_ground, 2] = rng.normal(0.0, 0.02, int(is_ground.sum()))
        normals[~is_facade] = 0.0
        normals[is_ground, 2] = 1.0
        reach = np.where(
            is_facade, FACADE_REACH, np.where(is_ground, GROUND_REACH, FURNITURE_REACH)
        )
        reach = reach * rng.uniform(0.6, 1.0, count)
        kept = np.where(is_facade, is_on, ~self._is_in_block(positions[:, 0], positions[:, 1]))
        points = Points(positions, normals, reach, positions)
        return points.take(kept)

    def draw_lengths(self, rng: np.random.Generator, count: int) -> Array:
        """Draw exponential lengths: tracks end with equal probability at every step."""
        return rng.standard_exponential(count)

    def preference(self, rng: np.random.Generator, points: Points, pairs: Pairs) -> Array:
        """Prefer consecutive images around a random image in view; some images are skipped."""
        del points
        middle = np.floor(rng.random(len(pairs.counts)) * pairs.counts)
        away = np.abs(pairs.ranks - np.repeat(middle, pairs.counts))
        preference: Array = away + rng.uniform(0.0, 1.6, len(pairs))
        return preference

    def _from_axes(self, xy: Array) -> tuple[Array, Array]:
        """Return offsets from the nearest road axes, and the positions of these axes."""
        axes = self.pitch * np.round(xy / self.pitch)
        return xy - axes, axes

    def _is_in_block(self, x: Array, y: Array) -> NDArray[np.bool_]:
        # One coordinate at a time: reductions over rows of two numbers take ten times as long.
        limit = 0.5 * ROAD_WIDTH
        outside_x, outside_y = (np.abs(self._from_axes(u)[0]) > limit for u in (x, y))
        inside: NDArray[np.bool_] = outside_x & outside_y
        return inside

    def _onto_facades(
        self, rng: np.random.Generator, xy: Array
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Move positions (n, 2) onto facades; return positions, normals (n, 3), mask of success.

        A position on a road moves to either side; a position in a block moves to its nearest side.
        Positions on crossings fail, because crossings have no facades.
        """
        offset, axes = self._from_axes(xy)
        half = 0.5 * ROAD_WIDTH
        in_road = np.abs(offset) <= half
        # The coordinate to change: across the road, or the coordinate closer to its facade.
        closer = np.argmin(np.abs(offset), axis=1)
        across = np.where(in_road.any(axis=1), np.argmax(in_road, axis=1), closer)
        rows = np.arange(len(xy))
        sides = np.where(rng.random(len(xy)) < 0.5, -1.0, 1.0)
        sides = np.where(in_road.any(axis=1), sides, np.sign(offset[rows, across]))
        depth = half + rng.exponential(0.12, len(xy))  # windows, doors and balconies
        moved = self._onto_windows(rng, xy)
        moved[rows, across] = axes[rows, across] + sides * depth
        normals = np.zeros((len(xy), 3))
        normals[rows, across] = -sides
        along = self._from_axes(moved)[0][rows, 1 - across]
        return moved, normals, ~in_road.all(axis=1) & (np.abs(along) > half)

    @staticmethod
    def _onto_windows(rng: np.random.Generator, xy: Array) -> Array:
        """Move three of five positions to edges of windows; windows are 3 m apart."""
        edges = 3.0 * np.floor(xy / 3.0) + np.where(rng.random(xy.shape) < 0.5, 0.8, 2.2)
        edges += rng.normal(0.0, 0.06, xy.shape)
        return np.where(rng.random((len(xy), 1)) < 0.6, edges, xy)

    @staticmethod
    def _window_height(rng: np.random.Generator, top: Array) -> Array:
        """Return random heights, denser near the ground; three of five are at edges of windows."""
        height = 0.3 + (top - 0.3) * rng.random(len(top)) ** 1.4
        edges = 3.0 * np.floor(height / 3.0) + np.where(rng.random(len(top)) < 0.5, 0.9, 2.3)
        edges += rng.normal(0.0, 0.05, len(top))
        return np.where(rng.random(len(top)) < 0.6, edges, height)

    def _height_of_block(self, xy: Array) -> Array:
        block = np.floor(xy / self.pitch).astype(np.int64)
        height: Array = self._block_heights[(73 * block[:, 0] + 179 * block[:, 1]) % 512]
        return height


def _wander(rng: np.random.Generator, count: int, sigma: float) -> Array:
    """Return a smooth random sequence of the given standard deviation, correlated over ~5 steps."""
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / 3.5) ** 2)
    kernel /= np.sqrt((kernel**2).sum())
    noise = rng.standard_normal(count + len(kernel) - 1)
    return sigma * np.convolve(noise, kernel, mode="valid")
