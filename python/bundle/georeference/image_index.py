"""Images of a problem by name or id, for files and priors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief, nearest, shown
from bundle.model.problem import Problem


class ImageIndex:
    """Finder of images by name: the whole name, or its last part if that is unique.

    Args:
        problem: problem of the images.
        argument: beginning of messages, such as "gps: ".

    Raises:
        InputError: the images have no names.
    """

    def __init__(self, problem: Problem, argument: str = "") -> None:
        if problem.num_images and not any(problem.image_names):
            raise InputError(f"{argument}expected images with names; BAL files have no names")
        self._problem = problem
        self._argument = argument
        self._whole: dict[str, list[int]] = {}
        self._last: dict[str, list[int]] = {}
        self._folded: dict[str, int] = {}
        for index, name in enumerate(problem.image_names):
            self._whole.setdefault(name, []).append(index)
            self._last.setdefault(last_part(name), []).append(index)
            self._folded.setdefault(last_part(name).casefold(), index)

    def find(self, name: str, place: str = "") -> int | None:
        """Return the index of an image; None if the model has no image of this name.

        Args:
            place: beginning of messages; by default the argument of the constructor.

        Raises:
            InputError: several images match.
        """
        found = self._whole.get(name) or self._last.get(last_part(name), [])
        if len(found) > 1:
            names = [self._problem.image_names[index] for index in found]
            ids = ", ".join(str(self._problem.image_ids[index]) for index in found)
            which = f"ids {ids}" if len(set(names)) == 1 else ", ".join(map(shown, names))
            raise InputError(
                f"{place or self._argument}expected one image of the model named {brief(name)}, "
                f"found {len(found)} ({which})"
            )
        return found[0] if found else None

    def differing_in_case(self, name: str) -> str | None:
        """Return the name of an image that differs from an unknown one only in case."""
        index = self._folded.get(last_part(name).casefold())
        return None if index is None else self._problem.image_names[index]


def last_part(name: str) -> str:
    """Return the name of a file without its folders."""
    return name.replace("\\", "/").rpartition("/")[2]


class ImageFinder:
    """Finder of images by name, or by id if no image has this name.

    Args:
        problem: problem of the images, with or without names.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._index = ImageIndex(problem) if any(problem.image_names) else None
        self._ids = set(problem.image_ids.tolist())

    def find(self, word: str, place: str = "") -> int:
        """Return the id of an image.

        Raises:
            InputError: no image or several images match.
        """
        row = None if self._index is None else self._index.find(word, place)
        if row is not None:
            return int(self._problem.image_ids[row])
        if word.isascii() and word.isdigit() and int(word) in self._ids:
            return int(word)
        meant = nearest(last_part(word), [last_part(name) for name in self._problem.image_names])
        raise InputError(
            f"{place}expected an image of the model by name or id, found {brief(word)}{meant}"
        )


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
