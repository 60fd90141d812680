"""Neighbour images of a local adjustment, which have the marginal prior of the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.problem_keys import parameter_names
from bundle.model.selection import Selection
from bundle.solving.rounds.local_part import LocalPart

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Neighbours:
    """Masks of the free neighbours of a part in the full problem; images of frames are excluded."""

    images: _Mask
    frames: _Mask
    cameras: _Mask

    @staticmethod
    def find(whole: Problem, part: LocalPart, options: SolveOptions) -> Neighbours:
        """Return the free neighbours of a part."""
        free = part.neighbours & ~np.isin(whole.image_ids, options.fixed_image_ids)
        frames = np.zeros(whole.num_frames, bool)
        if whole.num_frames:
            of_images = whole.image_frame[free]
            frames[of_images[of_images >= 0]] = True
            free = free & (whole.image_frame < 0)
        cameras = part.cameras & ~np.isin(whole.camera_ids, options.fixed_camera_ids)
        return Neighbours(free, frames, cameras)

    def rows_in(self, selection: Selection[Problem]) -> tuple[list[int], list[int], list[int]]:
        """Return the row indices in a selection of the images, frames and cameras it contains."""
        masks = (self.images, selection.images), (self.frames, selection.frames)
        images, frames, cameras = (
            np.flatnonzero(mask[indices]).tolist() if len(mask) else []
            for mask, indices in (*masks, (self.cameras, selection.cameras))
        )
        return images, frames, cameras

    def variables(self, whole: Problem) -> list[tuple[tuple[str, int], int]]:
        """Return the key and tangent size of each variable: images, then frames, then cameras."""
        found = [(("image", key), 6) for key in whole.image_ids[self.images].tolist()]
        found += [(("frame", key), 6) for key in whole.frame_ids[self.frames].tolist()]
        for row in np.flatnonzero(self.cameras).tolist():
            width = len(parameter_names("rest", whole, row))
            found.append((("camera", int(whole.camera_ids[row])), width))
        return found

    def size(self, whole: Problem) -> int:
        """Return the number of tangent coordinates of all variables."""
        return sum(size for _, size in self.variables(whole))

    def coordinates(self, whole: Problem, selection: Selection[Problem]) -> NDArray[np.int64]:
        """Return the indices of the tangent coordinates of the variables in a selection."""
        images, frames, cameras = self.rows_in(selection)
        problem = selection.problem
        there = {("image", int(problem.image_ids[row])) for row in images}
        there |= {("frame", int(problem.frame_ids[row])) for row in frames}
        there |= {("camera", int(problem.camera_ids[row])) for row in cameras}
        masks = [np.full(size, key in there) for key, size in self.variables(whole)]
        return np.flatnonzero(np.concatenate(masks)) if masks else np.empty(0, np.int64)

    def values(self, whole: Problem) -> list[tuple[tuple[str, int], _Floats]]:
        """Return the key and value of each variable: images, then frames, then cameras."""
        rows = [*whole.cam_from_world[self.images], *whole.rig_from_world[self.frames]]
        for row in np.flatnonzero(self.cameras).tolist():
            width = len(parameter_names("rest", whole, row))
            rows.append(whole.camera_params[row, :width])
        return [(key, value) for (key, _), value in zip(self.variables(whole), rows, strict=True)]
