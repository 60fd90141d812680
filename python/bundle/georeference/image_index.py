"""Images of a problem by their names, as lists of positions and of control points have them."""

from __future__ import annotations

from bundle.errors import InputError
from bundle.problem import Problem

__all__ = ["ImageIndex"]


class ImageIndex:
    """Finds images by name: the whole name, or its last part where that is unique.

    Args:
        problem: whose images they are.
        argument: what messages begin with, such as "gps: ".

    Raises:
        InputError: the images have no names.
    """

    def __init__(self, problem: Problem, argument: str = "") -> None:
        if problem.num_images and not any(problem.image_names):
            raise InputError(
                f"{argument}expected images with names, which BAL files do not have, found none"
            )
        self._whole = {name: index for index, name in enumerate(problem.image_names)}
        self._last: dict[str, int] = {}
        for name, index in self._whole.items():
            last = _last_part(name)
            self._last[last] = -1 if last in self._last else index

    def find(self, name: str) -> int | None:
        """Return the index of an image, None where the model has none of this name."""
        if name in self._whole:
            return self._whole[name]
        index = self._last.get(_last_part(name), -1)
        return None if index < 0 else index


def _last_part(name: str) -> str:
    return name.replace("\\", "/").rpartition("/")[2]
