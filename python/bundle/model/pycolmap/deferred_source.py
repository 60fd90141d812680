"""A COLMAP model that was read, and becomes a ``pycolmap.Reconstruction`` on first use.

Importing pycolmap and building a reconstruction takes longer than solving a small problem, and most
commands need neither: our own reader gives the arrays, and a problem whose numbers alone have
changed is written by replacing them in the files, which stay in memory for that.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from bundle import _core

if TYPE_CHECKING:
    import pycolmap

__all__ = ["DeferredSource"]


class DeferredSource:
    """The source of a problem that was read from a COLMAP model, shared by its edits.

    Args:
        model: the files as they were read.
        fields: the fields of the problem that the model is, by name.
        reconstruct: makes a reconstruction of the model.
    """

    def __init__(
        self,
        model: _core.ColmapModel,
        fields: Mapping[str, Any],
        reconstruct: Callable[[_core.ColmapModel], pycolmap.Reconstruction],
    ) -> None:
        self._model: _core.ColmapModel | None = model
        self._fields = fields
        self._reconstruct = reconstruct
        self._reconstruction: pycolmap.Reconstruction | None = None
        self._lock = threading.Lock()

    @property
    def fields(self) -> Mapping[str, Any]:
        """The fields of the problem that the model is, by name."""
        return self._fields

    @property
    def model(self) -> _core.ColmapModel | None:
        """The files; None once there is a reconstruction, which its holders may change."""
        return self._model

    def reconstruction(self) -> pycolmap.Reconstruction:
        """Return the model as a reconstruction, always the same.

        Raises:
            InputError: this version of pycolmap cannot read it.
            MemoryError: a limit of memory leaves too little for pycolmap.
            OSError: there is no room for temporary files.
        """
        with self._lock:
            if self._reconstruction is None:
                assert self._model is not None
                self._reconstruction = self._reconstruct(self._model)
                self._model = None
            return self._reconstruction
