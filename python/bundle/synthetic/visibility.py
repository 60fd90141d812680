"""Which points an image could observe.

A point is visible when its key lies in the ball of the image, it is no farther than its reach, its
surface faces the camera, it projects into the image and nothing stands in between. Where far more
images see a point than its track needs, pairs are thinned at random before these tests, evenly
over what the image's ball holds, so that the work grows with the observations asked for. The core
does so (``cpp/core/synthetic``).

A uniform grid over points, of which only the occupied cells are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.interface.scene_options import MIN_OBSERVATIONS_PER_IMAGE
from bundle.synthetic.intrinsics import Intrinsics
from bundle.synthetic.scene import Pairs, Points, Scene

__all__ = ["Cells", "Visibility"]


Array = NDArray[np.float64]


class Cells:
    """Which points are in which cell.

    Attributes:
        centers: (num_cells, 3)
        half_diagonal: of a cell.
        order: (n,) the points, cell by cell.
        starts: (num_cells + 1,) where each cell begins in ``order``.
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


# Of the pairs that pass thinning perhaps a third are visible; a track wants some choice of images.
_PAIRS_PER_OBSERVATION = 6.0
# Beyond this, relative to the corner of the image, distortion polynomials may fold back into it.
_FIELD_MARGIN = 1.15


class Visibility:
    """The images of a scene with their true cameras, and what they see."""

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
        """Return who could observe what.

        Args:
            rng: source of the thinning.
            points: the points.
            lengths: (n,) observations that each point wants.
            num_threads: 0: all cores. The pairs are the same with any number.
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
        """Return the exact projections (M, 2) of observations of positions (n, 3), in pixels."""
        return self._images.exact_pixels(
            positions, observation_image, observation_point, num_threads
        )
