"""Decision between processes that each read a slice of INPUT and one process that reads it all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bundle.interface.options import SolveOptions
from bundle.io.atomic.model_files import ROLLING_SHUTTER, is_text_model, missing_model_files
from bundle.io.open import output_format, recover
from bundle.io.recognition import imported_format
from bundle.solving.ranks.launch import current

if TYPE_CHECKING:
    from bundle.solving.slices.sliced_refinement import SlicedRefinement

COMPRESSED = (".gz", ".bz2")


def sliced_input(
    source: str, target: str, format: str | None, options: SolveOptions
) -> SlicedRefinement | None:
    """Return the refinement of INPUT in slices; None if one process must read it all.

    One process reads everything if it is the only one, if INPUT is a COLMAP text model, or if the
    output is compressed or has another format than INPUT. It also does so for options that do not
    support a distributed solve.

    Raises:
        InputError: INPUT has no observations, or is not in its declared format.
        OSError: a file cannot be read.
    """
    crew = current()
    if crew is None:
        return None
    from bundle.solving.ranks.mpi_crew import MpiCrew  # only under mpirun
    from bundle.solving.ranks.one_process import reason_in_options

    if not isinstance(crew, MpiCrew):
        return None
    if reason_in_options(options.asdict()):
        return None
    path = Path(source)
    recover(path)
    if (path / ROLLING_SHUTTER).is_file():  # slices know only global shutters
        return None
    source_format = sliceable_format(path)
    if source_format is None:
        return None
    if not has_copied_format(target, format, source, source_format):
        return None
    from bundle.solving.slices.sliced_refinement import SlicedRefinement

    return SlicedRefinement(crew, path)


def has_copied_format(target: str, format: str | None, source: str, source_format: str) -> bool:
    """Return True if OUTPUT can be copied from INPUT file by file: same format, not compressed."""
    target_format = output_format(source_format, target, format, source)
    is_compressed = target_format == "bal" and Path(target).suffix.lower() in COMPRESSED
    return target_format == source_format and not is_compressed


def sliceable_format(source: Path) -> str | None:
    """Return "bal" or "colmap" for inputs that can be read in slices, otherwise None."""
    if source.is_file():
        return "bal" if imported_format(source) is None else None
    is_binary = source.is_dir() and not missing_model_files(source) and not is_text_model(source)
    return "colmap" if is_binary else None
