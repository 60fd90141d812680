"""Images of priors: rows of a problem by id or name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief, nearest
from bundle.model.problem import Problem


class HasImage(Protocol):
    """Prior of one image."""

    @property
    def image(self) -> int | str:
        """Id or name."""


def rows_of_images(problem: Problem, priors: Sequence[HasImage]) -> NDArray[np.int64]:
    """Return the index of each prior's image.

    Raises:
        InputError: an image is not in the problem, its name is not unique, or two priors have the
            same image.
    """
    names: dict[str, int] = {}
    twice: set[str] = set()
    for index, name in enumerate(problem.image_names):
        if name in names:
            twice.add(name)
        names[name] = index
    ids = {image_id: index for index, image_id in enumerate(problem.image_ids.tolist())}
    rows: dict[int, int] = {}
    for position, prior in enumerate(priors):
        place = f"priors: [{position}]: image"
        image = prior.image
        row = names.get(image) if isinstance(image, str) else ids.get(int(image))
        if row is None or image in twice:
            meant = nearest(image, list(names)) if isinstance(image, str) else ""
            found = f"0{meant}" if row is None else "several"
            raise InputError(
                f"{place}: expected exactly one image {brief(image)} in the problem, found {found}"
            )
        if row in rows:
            raise InputError(
                f"{place}: expected one prior per image, found another prior of {brief(image)} "
                f"(the first: [{rows[row]}])"
            )
        rows[row] = position
    return np.fromiter(rows, dtype=np.int64, count=len(rows))
