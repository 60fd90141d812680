"""Index of images by name, for lists of positions and of control points."""

from __future__ import annotations

from bundle.errors import InputError, brief, shown
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
            name: name of the image.
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
