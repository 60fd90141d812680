"""Whether the processes of mpirun can each read a slice of INPUT, and no process all of it."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.options import SolveOptions
from bundle.ranks import current

if TYPE_CHECKING:
    from bundle.slices.bal_refinement import BalRefinement

__all__ = ["sliced_input"]

COMPRESSED = (".gz", ".bz2")

# Flags beside the options of a solve that have nothing to do with the observations.
_HARMLESS = {"command", "run", "input", "output", "json", "quiet", "format", "fixed_image_ids"}


def sliced_input(arguments: argparse.Namespace) -> BalRefinement | None:
    """Return the refinement of a BAL file in slices; None where one process has to read it all.

    That is any other format, one process, and any flag beside the options of a plain solve.

    Raises:
        InputError: the file has no observations, or is not what the format says.
        OSError: the file cannot be read.
    """
    from bundle.ranks.mpi_crew import MpiCrew

    crew = current()
    source, target = Path(arguments.input), Path(arguments.output)
    if not isinstance(crew, MpiCrew) or not source.is_file():
        return None
    plain = _HARMLESS | {field.name for field in dataclasses.fields(SolveOptions)}
    others = {name: value for name, value in vars(arguments).items() if name not in plain}
    given = [value for value in others.values() if value not in (None, False, [], ())]
    is_bal = arguments.format in (None, "bal") and str(arguments.output)[-1:] != "/"
    if given or not is_bal or target.is_dir() or target.suffix.lower() in COMPRESSED:
        return None
    from bundle.slices.bal_refinement import BalRefinement

    return BalRefinement(crew, source)
