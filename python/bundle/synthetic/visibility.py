"""Visibility: the points that an image can observe.

A point is visible if all conditions hold: its key is in the ball of the image, the camera is within
its reach, its surface faces the camera, it projects into the image, and nothing occludes it. Often
far more images see a point than its track needs. Pairs are then thinned at random before these
tests, evenly within the image's ball, so that the work is proportional to the requested
observations. The C++ core does this (``cpp/core/synthetic``).

Points are sorted into a uniform grid. Only occupied cells are stored.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.interface.scene_options import MIN_OBSERVATIONS_PER_IMAGE
from bundle.synthetic.intrinsics import Intrinsics
from bundle.synthetic.scene import Pairs, Points, Scene

Array = NDArray[np.float64]


class Cells:
    """Points by grid cell.

    Attributes:
        centers: (num_cells, 3) centres of the cells.
        half_diagonal: half the diagonal of a cell.
        order: (n,) points, cell by cell.
        starts: (num_cells + 1,) begin of each cell in ``order``.
    """

    order: NDArray[np.int64]
    starts: NDArray[np.int64]

    def __init__(self, keys: Array, size: float) -> None:
        grid = np.floor((keys - keys.min(axis=0)) / size).astype(np.int64)
        extent = grid.max(axis=0) + 1
        code = (grid[:, 0] * extent[1] + grid[:, 1]) * extent[2] + grid[:, 2]
        self.order = np.argsort(code, kind="stable")
        code = code[self.order]
        first = np.flatnonzero(np.concatenate([[True], code[1:] != code[:-1]]))
        self.starts = np.append(first, len(code))
        self.centers = (grid[self.order[first]] + 0.5) * size + keys.min(axis=0)
        self.half_diagonal = 0.5 * float(np.sqrt(3.0)) * size

    def __len__(self) -> int:
        return len(self.starts) - 1


# About a third of the thinned pairs are visible, and a track needs some choice of images.
_PAIRS_PER_OBSERVATION = 6.0
# Beyond this multiple of the image corner, distortion polynomials may fold back into the image.
_FIELD_MARGIN = 1.15


class Visibility:
    """Tests of visibility in the images of a scene, with their true cameras."""

    def __init__(self, scene: Scene, intrinsics: Intrinsics) -> None:
        images = scene.images
        sizes = images.sizes.astype(np.float64)
        corners = 0.5 * np.hypot(sizes[:, 0], sizes[:, 1]) / (images.focal * sizes.max(axis=1))
        self._cell_size = 0.5 * float(np.median(images.ball_radii))
        self._images = _core.SyntheticImages(
            images.centers,
            images.rotations,
            images.ball_centers,
            images.ball_radii,
            _FIELD_MARGIN * corners,
            sizes,
            images.richness,
            intrinsics.image_camera,
            intrinsics.params,
            intrinsics.model,
            scene.min_cosine,
            *scene.blocks,
        )

    def pairs(
        self, rng: np.random.Generator, points: Points, lengths: Array, num_threads: int = 0
    ) -> Pairs:
        """Return the possible observations.

        Args:
            rng: source of the thinning.
            points: the points.
            lengths: (n,) wanted number of observations of each point.
            num_threads: number of threads; 0: all cores. The pairs do not depend on it.
        """
        cells = Cells(points.keys, self._cell_size)
        by_cell = points.take(cells.order)
        point, image = self._images.visible_pairs(
            by_cell.positions,
            by_cell.normals,
            by_cell.reach,
            by_cell.keys,
            cells.centers,
            cells.half_diagonal,
            cells.starts,
            cells.order,
            _PAIRS_PER_OBSERVATION * lengths[cells.order],
            10 * MIN_OBSERVATIONS_PER_IMAGE,
            rng.bit_generator.capsule,
            num_threads,
        )
        return Pairs.from_sorted(point, image, len(points))

    def pixels(
        self,
        positions: Array,
        observation_image: NDArray[np.int32],
        observation_point: NDArray[np.int32],
        num_threads: int = 0,
    ) -> Array:
        """Return the exact projections (M, 2) [pixels] of observed points at positions (n, 3)."""
        return self._images.exact_pixels(
            positions, observation_image, observation_point, num_threads
        )
