"""A COLMAP model in memory that is converted to a ``pycolmap.Reconstruction`` on first use.

Importing pycolmap and building a reconstruction takes longer than solving a small problem. No
command needs them. This package's reader returns arrays. Its writer takes the records that a
problem lacks from the files: those that are small are kept in memory, the others stay open.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bundle._core as _core
from bundle.base.optional_packages import require_pycolmap
from bundle.base.own_process import PYCOLMAP, interrupts_deferred, require_memory
from bundle.errors import InputError, first_line

if TYPE_CHECKING:
    import pycolmap


class DeferredSource:
    """Source of a problem that was read from a COLMAP model; edited copies share it.

    Args:
        model: the files; changes of large ones since the reading raise an InputError.
        fields: fields of the problem of this model, by name.
        folder: folder of the files, for messages.
    """

    def __init__(self, model: _core.ColmapModel, fields: Mapping[str, Any], folder: Path) -> None:
        self._model: _core.ColmapModel | None = model
        self._fields = fields
        self._folder = folder
        self._reconstruction: pycolmap.Reconstruction | None = None
        self._lock = threading.Lock()

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        """Return an independent source: callers may edit the reconstruction of each."""
        with self._lock:
            if self._model is None:
                return copy.deepcopy(self._reconstruction, memo)
            return DeferredSource(self._model, self._fields, self._folder)

    @property
    def fields(self) -> Mapping[str, Any]:
        """Fields of the problem of this model, by name."""
        return self._fields

    @property
    def folder(self) -> Path:
        """Folder of the files, for messages."""
        return self._folder

    @property
    def model(self) -> _core.ColmapModel | None:
        """The files; None after the conversion, because callers may edit the reconstruction."""
        return self._model

    @property
    def has_changed(self) -> bool:
        """True if a file that is open, not in memory, was written to since it was read."""
        return self._model is not None and self._model.has_changed

    def reconstruction(self) -> pycolmap.Reconstruction:
        """Return the model as a reconstruction; every call returns the same object.

        Raises:
            InputError: this version of pycolmap cannot read the model.
            MemoryError: a memory limit leaves too little for pycolmap.
            OSError: the disk has too little space for temporary files.
        """
        with self._lock:
            if self._reconstruction is None:
                assert self._model is not None
                self._reconstruction = _read_by_pycolmap(self._model, self._folder)
                self._model = None
            return self._reconstruction


def _read_by_pycolmap(model: _core.ColmapModel, folder: Path) -> pycolmap.Reconstruction:
    """Return the reconstruction that pycolmap builds from the bytes of the files in memory."""
    require_pycolmap("the source of a problem as a pycolmap.Reconstruction")
    require_memory("pycolmap", PYCOLMAP)
    import tempfile  # slow to import

    with interrupts_deferred():  # the import of pycolmap cannot be interrupted
        import pycolmap
    reconstruction = pycolmap.Reconstruction()
    # Use the files that were read: others may have their names now.
    with tempfile.TemporaryDirectory(prefix="bundle-") as temporary:
        for name, content in model.files().items():
            (Path(temporary) / name).write_bytes(content)
        try:
            if model.is_binary:
                reconstruction.read_binary(temporary)
            else:
                reconstruction.read_text(temporary)
        except (ValueError, LookupError, RuntimeError, MemoryError) as error:
            # Older versions of pycolmap lack the newest camera models.
            raise InputError(
                f"{folder}: expected a model that pycolmap {pycolmap.__version__} reads, "
                f"found: {first_line(error)}"
            ) from None
    for image_id, name in model.names_with_spaces.items():
        reconstruction.image(image_id).name = name
    return reconstruction
