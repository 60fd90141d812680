"""A COLMAP model that was read, and becomes a ``pycolmap.Reconstruction`` on first use.

Importing pycolmap and building a reconstruction takes longer than solving a small problem. No
command needs either: our reader returns arrays, and our writer takes the records that a problem
lacks from the files, which stay in memory.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle import _core
from bundle.base import address_space
from bundle.base.interrupts import interrupts_deferred
from bundle.errors import InputError, first_line

if TYPE_CHECKING:
    import pycolmap

__all__ = ["DeferredSource"]


class DeferredSource:
    """The source of a problem that was read from a COLMAP model, shared by its edits.

    Args:
        model: the files as they were read.
        fields: the fields of the problem that the model is, by name.
        folder: of the files, for messages.
    """

    def __init__(self, model: _core.ColmapModel, fields: Mapping[str, Any], folder: Path) -> None:
        self._model: _core.ColmapModel | None = model
        self._fields = fields
        self._folder = folder
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
                self._reconstruction = _read_by_pycolmap(self._model, self._folder)
                self._model = None
            return self._reconstruction


def _read_by_pycolmap(model: _core.ColmapModel, folder: Path) -> pycolmap.Reconstruction:
    """Read a model by pycolmap, from its files as they were read."""
    address_space.require("pycolmap", address_space.PYCOLMAP)
    import tempfile  # slow to import

    with interrupts_deferred():  # the import of pycolmap cannot be interrupted
        import pycolmap
    reconstruction = pycolmap.Reconstruction()
    # The files as they were read: those on the disk may have changed.
    with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
        for name, content in model.files().items():
            (Path(temporary) / name).write_bytes(content)
        try:
            if model.is_binary:
                reconstruction.read_binary(temporary)
            else:
                reconstruction.read_text(temporary)
        except (ValueError, LookupError, RuntimeError, MemoryError) as error:
            # Older versions lack the newest camera models.
            raise InputError(
                f"{folder}: expected a model that pycolmap {pycolmap.__version__} reads, "
                f"found: {first_line(error)}"
            ) from None
    for image_id, name in model.names_with_spaces.items():
        reconstruction.image(image_id).name = name
    return reconstruction
