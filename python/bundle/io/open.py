"""Reading and writing of problems: COLMAP models, BAL files, and formats of other programs.

When reading, the format is detected from the content. Writing is atomic: see
``bundle.io.atomic.atomic_write``. If a killed process left a partly replaced model, reading and
writing first complete the replacement and warn (UserWarning).
"""

from __future__ import annotations

import dataclasses
import os
import re
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from bundle.base.arrays import check_type
from bundle.base.paths import as_path, compression_of
from bundle.errors import InputError, brief, shown
from bundle.interface.option_fields import choice
from bundle.io import bal, colmap
from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.replaced_paths import (
    MODEL_FILES,
    RecoveryWarning,
    is_text_model,
    missing_model_files,
)
from bundle.io.colmap import check_is_model
from bundle.io.formats.read_options import ORIGINS, ReadOptions
from bundle.io.formats.registry import (
    FOLDERS,
    Format,
    file_at,
    find_format,
    format_for_name,
    format_written,
    names_read,
    names_written,
)
from bundle.io.georeference_file import remove_georeference
from bundle.io.recognition import (
    OUTPUT_FORMATS,
    check_name,
    format_by_members,
    format_of_name,
    imported_format,
    is_pose_graph_file,
    other_format_at,
)
from bundle.io.rolling_shutter_file import LOST_ROLLING_SHUTTER, rolling_shutter_record
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import DeferredSource

_WORD = re.compile(r"\.[A-Za-z]+")
_BAL_SUFFIXES = (".txt", ".txt.gz", ".txt.bz2")


def load(
    path: str | os.PathLike[str],
    progress: Callable[[int], None] | None = None,
    options: ReadOptions | None = None,
) -> Problem:
    """Read a COLMAP model folder, a BAL file, or a reconstruction of another program.

    Args:
        path: path of the folder or file.
        progress: called repeatedly while text is read, with the bytes read so far.
        options: information that the file does not have.

    Raises:
        InputError: the content violates its format; one line with path, place, expected and actual
            value.
        OSError: the path does not exist or cannot be read.
    """
    path = as_path(path)
    recover(path)
    options = dataclasses.replace(options or ReadOptions(), progress=progress)
    imported = _imported(path, options)
    if options.pixel_origin != ORIGINS[0] and (imported is None or imported.name != "nvm"):
        raise InputError(f"pixel_origin: expected an NVM file, found {shown(path)}")
    if imported is not None:
        return imported.reading().read(file_at(path, imported), options)  # type: ignore[no-any-return]
    if path.is_dir():
        check_is_model(path)
        return colmap.load(path)
    if path.name in MODEL_FILES and not missing_model_files(path.parent):
        raise InputError(
            f"{shown(path)}: expected the folder of a COLMAP model, found one of its files; "
            f"try {shown(path.parent)}"
        )
    if is_pose_graph_file(path):
        raise InputError(f"{shown(path)}: expected a reconstruction, found a pose graph")
    other = other_format_at(path)
    by_name = format_for_name(path) if other and other == format_of_name(path) else None
    if by_name is not None and by_name.reads:
        return by_name.reading().read(path, options)  # type: ignore[no-any-return]  # states the fault
    if other is not None:
        raise InputError(f"{shown(path)}: expected {names_read()}, found {other}")
    return bal.load(path, progress)


def save(
    problem: Problem,
    path: str | os.PathLike[str],
    format: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[str, ...]:
    """Write a problem; return one sentence for each kind of information that the format loses.

    The content of ``path`` is replaced only when the new content is complete on the disk. A folder
    must be empty or a COLMAP model. Only its model files are replaced, and the georeference.json of
    the old model is removed.

    Args:
        problem: the problem to write.
        path: a BAL file (a name that ends in ".gz" or ".bz2" is compressed) or a COLMAP folder.
        format: one of ``OUTPUT_FORMATS``, such as "colmap" (binary); None: see ``output_format``.
        progress: called repeatedly while a BAL file is written, with the bytes of text so far.

    If large files of a COLMAP model were written to since they were read (``ModelFile`` of the
    core), the information that only they have is lost, too.

    Raises:
        InputError: the format cannot hold the problem, or the path cannot be replaced.
        OSError: a system call fails, for example without permission or on a full disk.
    """
    _check_problem(problem)
    recover(path)
    try:
        return _save(problem, path, format, progress)
    except InputError:
        source = vars(problem)["source"]
        if not (isinstance(source, DeferredSource) and source.has_changed):
            raise
    # The result of a long solve must not be lost with the files that it came from.
    lost = (
        f"{shown(source.folder)} has changed since it was read: keypoints without a point and "
        "colours are left out.",
    )
    return lost + _save(problem.replace(source=None), path, format, progress)


def _save(
    problem: Problem,
    path: str | os.PathLike[str],
    format: str | None,
    progress: Callable[[int], None] | None,
) -> tuple[str, ...]:
    chosen = output_format(problem.format, path, format)
    path = as_path(path)
    if chosen == "bal":
        lost = bal.losses(problem)
        with atomic.replace_file(path) as temporary:
            bal.save(problem, temporary, compression_of(path), progress)
            remove_georeference(path, is_folder=False)
        return lost + _lost_shutter(problem)
    imported = find_format(chosen)
    if imported is not None:
        return _save_imported(problem, path, imported) + _lost_shutter(problem)
    return save_model(path, chosen, lambda to: colmap.save(problem, to, binary=chosen == "colmap"))


def save_model(
    path: Path, format: str, write: Callable[[Path], tuple[str, ...]]
) -> tuple[str, ...]:
    """Replace a COLMAP model by another; return one sentence for each loss of information.

    Args:
        path: path of the folder.
        format: "colmap" (binary) or "colmap-text".
        write: function that writes the model files into a folder and returns sentences on the
            information that they do not hold.
    """
    going = _files_of_other_format(path, format)
    with atomic.replace_folder(path) as temporary:
        lost = write(temporary)
        remove_georeference(path, is_folder=True)
    return lost + going


def output_format(
    source_format: str,
    path: str | os.PathLike[str],
    format: str | None = None,
    source: str | os.PathLike[str] | None = None,
) -> str:
    """Return the format in which ``save`` writes, such as "bal", "colmap" or "colmap-text".

    The first rule that applies decides:

    * An explicit format.
    * The path. Names in ".txt", ".txt.gz" and ".txt.bz2" mean BAL, ".out" Bundler, ".nvm" NVM. An
      existing folder or a trailing slash means COLMAP: text if the folder holds a text model,
      binary if it holds a binary model; a folder with reconstruction.json means OpenSfM. An
      existing transforms.json of any name stays one.
    * The format of the problem; COLMAP for a problem from memory. COLMAP is text
      if the problem was read from a text model at ``source``, otherwise binary. A new path must
      have neither a suffix of letters (``x.foo``) nor the name of another format (``nvm``).
    """
    folder = as_path(path)
    if format is not None:
        return format if _is_of_others(format) else choice("format", format, OUTPUT_FORMATS)
    name = os.fspath(path)
    default = "colmap-text" if source is not None and is_text_model(Path(source)) else "colmap"
    if folder.is_dir() and not missing_model_files(folder):
        return "colmap-text" if is_text_model(folder) else "colmap"
    if folder.is_dir() and (known := imported_format(folder, others=False)) and known.is_folder:
        return known.name
    if name.endswith("/") or folder.is_dir():
        return default
    if name.lower().endswith(_BAL_SUFFIXES):
        return "bal"
    known = format_for_name(folder) or format_written(folder)
    if known is not None:
        return known.name
    check_name(path, names_written(), compressed=".txt")
    own = find_format(source_format)
    kept = "bal" if source_format == "bal" else default
    kept = own.name if own is not None and own.writes else kept
    if folder.name in OUTPUT_FORMATS and not folder.exists() and not kept.startswith(folder.name):
        raise InputError(
            f"{shown(path)}: expected a path, found the name of a format; --format {folder.name} "
            "gives any path this format"
        )
    if own is not None and own.writes and own.is_folder:
        return kept  # the name of a project is free
    if _WORD.fullmatch(folder.suffix) and not folder.exists():
        raise InputError(
            f"{shown(path)}: expected a name of {names_written()}, found a name in "
            f"{shown(folder.suffix)}; --format gives any name a format"
        )
    return kept


def check_target(
    problem: Problem,
    path: str | os.PathLike[str],
    format: str | None = None,
    refined: Collection[str] = (),
    fixed_camera_ids: Collection[int] = (),
) -> None:
    """Raise, before a long solve, the errors that ``save`` would raise after it.

    Args:
        path: as for ``save``.
        format: as for ``save``.
        refined: kinds of camera parameters that the solve will change: "focal",
            "principal_point", "extra". Other kinds have no effect.
        fixed_camera_ids: cameras that the solve will not change.
    """
    recover(path)
    chosen = output_format(problem.format, path, format)
    if chosen == "bal":
        bal.check_refined(problem, refined, fixed_camera_ids)
        atomic.check_file(Path(path))
        return
    imported = find_format(chosen)
    if imported is not None:
        _check_imported(problem, Path(path), imported)
        return
    atomic.check_folder(Path(path))
    colmap.check_save(problem, binary=chosen == "colmap")


def recover(path: str | os.PathLike[str]) -> None:
    """Complete an interrupted replacement at a path and warn about it."""
    for sentence in atomic.recover(as_path(path)):
        warnings.warn(sentence, RecoveryWarning, stacklevel=3)


def _imported(path: Path, options: ReadOptions) -> Format | None:
    """Return the format of another program that a path has, or that the user named."""
    if options.format is None:
        return imported_format(path) or format_by_members(path)
    if options.format in ("bal", "colmap", "colmap-text"):
        return None
    known = find_format(options.format)
    if known is None or not known.reads:
        readable = [f for f in OUTPUT_FORMATS if (g := find_format(f)) is None or g.reads]
        raise InputError(
            f"input format: expected one of {', '.join(readable)}, found {brief(options.format)}"
        )
    return known


def _is_of_others(name: object) -> bool:
    """Return True for the name of a format of another package."""
    return isinstance(name, str) and name not in OUTPUT_FORMATS and find_format(name) is not None


def _check_imported(problem: Problem, path: Path, known: Format) -> None:
    """Raise the error that writing this format would raise."""
    functions = known.writing()
    if not known.writes:
        raise InputError(f"format: expected a format that can be written, found {known.name}")
    if known.is_folder:
        if path.is_dir() and not missing_model_files(path):
            raise InputError(
                f"{shown(path)}: expected {known.what} or a new path, found a COLMAP model"
            )
        atomic.check_file(path / "file" if path.is_dir() else path)
    else:
        atomic.check_file(path)
    check = getattr(functions, "check", None)
    if check is not None:
        check(problem, path)


def _save_imported(problem: Problem, path: Path, known: Format) -> tuple[str, ...]:
    _check_imported(problem, path, known)
    write = known.writing().write
    if known.is_folder:
        return tuple(write(problem, path))
    with atomic.replace_file(path) as temporary:
        lost = tuple(write(problem, temporary))
        beside = getattr(known.writing(), "write_beside", None)
        if beside is not None:
            beside(problem, path)
        remove_georeference(path, is_folder=False)
    return lost


def _lost_shutter(problem: Problem) -> tuple[str, ...]:
    """Return a sentence if a problem has a rolling shutter: only COLMAP models have its file."""
    return () if rolling_shutter_record(problem) is None else (LOST_ROLLING_SHUTTER,)


def is_folder_format(format: str) -> bool:
    """Return True if the output of a format is a folder."""
    known = find_format(format)
    return format in FOLDERS or (known is not None and known.is_folder)


def _files_of_other_format(folder: Path, format: str) -> tuple[str, ...]:
    """Return a sentence if model files in the other format will be removed, otherwise ().

    Without their removal they would contradict the new model.
    """
    suffix = ".txt" if format == "colmap" else ".bin"
    names = [name for name in sorted(MODEL_FILES) if name.endswith(suffix)]
    going = [name for name in names if (folder / name).exists()]
    return (f"Files of the previous model are removed: {', '.join(going)}.",) if going else ()


def _check_problem(problem: Problem) -> None:
    check_type("problem", problem, Problem, "a Problem, such as result.problem")


_HEAD = struct.Struct("<I7dI")  # id, pose, camera
_COUNT = struct.Struct("<Q")
_KEYPOINT = 24  # bytes: x, y, point


def has_same_images(path: Path, names: Sequence[str]) -> bool:
    """Return True if a model on the disk has images with exactly these names.

    Only the number of images is compared if names are empty, and for BAL files, which have no
    names.
    """
    imported = imported_format(path, others=False)
    if imported is not None:
        problem = imported.reading().read(file_at(path, imported), ReadOptions(image_size=(0, 0)))
        return _same(list(problem.image_names), names)
    if path.is_file():
        return _bal_images(path) == len(names)
    found = list(_text_names(path) if is_text_model(path) else _binary_names(path))
    return _same(found, names)


def _same(found: list[str], names: Sequence[str]) -> bool:
    if all(names) and all(found):
        return Counter(found) == Counter(names)
    return len(found) == len(names)


def _binary_names(folder: Path) -> Iterator[str]:
    path = folder / "images.bin"
    data = path.read_bytes()
    try:
        place = _COUNT.size
        for _ in range(_COUNT.unpack_from(data)[0]):
            begin = place + _HEAD.size
            end = data.index(b"\0", begin)
            yield data[begin:end].decode(errors="surrogateescape")
            place = end + 1 + _COUNT.size + _KEYPOINT * _COUNT.unpack_from(data, end + 1)[0]
    except (struct.error, ValueError):
        raise InputError(f"{shown(path)}: expected images, found the end of the file") from None


def _text_names(folder: Path) -> Iterator[str]:
    is_image = True
    with (folder / "images.txt").open(encoding="utf-8", errors="surrogateescape") as lines:
        for line in lines:
            if line.startswith("#"):
                continue
            if is_image:
                words = line.strip().split(" ", 9)
                if len(words) < 10:
                    continue
                yield words[9]
            is_image = not is_image


def _bal_images(path: Path) -> int:
    with path.open("rb") as file:
        start = file.read(64)
        file.seek(0)
        if start.startswith(b"\x1f\x8b"):
            import gzip  # late: models need no compressors

            start = gzip.GzipFile(fileobj=file).read(64)
        elif start.startswith(b"BZh"):
            import bz2

            start = bz2.BZ2File(file).read(64)
    try:
        return int(start.split()[0])
    except (IndexError, ValueError):
        raise InputError(
            f"{shown(path)}: expected a BAL file, which begins with counts, found other content"
        ) from None
