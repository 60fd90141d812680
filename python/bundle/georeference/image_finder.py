"""Images of a problem by name or id, for files that refuse unknown images."""

from __future__ import annotations

from bundle.errors import InputError, brief, nearest
from bundle.georeference.image_index import ImageIndex, last_part
from bundle.model.problem import Problem


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

        Args:
            word: name of the image, its last part, or its id.
            place: beginning of messages.

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
