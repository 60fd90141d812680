"""The one exception for everything a user can get wrong."""

from bundle._core import InputError

__all__ = ["InputError"]
