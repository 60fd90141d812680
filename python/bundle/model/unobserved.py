"""Problems without observations, in the same words for every format and command."""

from __future__ import annotations

from bundle.base.words import Counts, contents
from bundle.errors import InputError

__all__ = ["require_observations", "unobserved"]

_ADVICE = "; triangulate points first, for example with `colmap point_triangulator`"


def unobserved(problem: Counts) -> str:
    """Return a sentence about a problem without observations; empty with observations."""
    found = _content_without_observations(problem)
    return f"There are no observations to refine, only {found}." if found else ""


def require_observations(problem: Counts, name: str) -> None:
    """Refuse a problem that cannot be refined.

    Args:
        problem: the problem.
        name: path or name, for the message.

    Raises:
        InputError: there are no observations.
    """
    found = _content_without_observations(problem)
    if found:
        raise InputError(f"{name}: expected observations to refine, found {found}")


def _content_without_observations(problem: Counts) -> str:
    if problem.num_observations:
        return ""
    return contents(problem) + (_ADVICE if problem.num_images and not problem.num_points else "")
