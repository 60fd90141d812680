"""Option of a refinement whose observations and points are on disk."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class OutOfCoreOptions(Options):
    """Folder for problems that are larger than the memory."""

    out_of_core: str | None = option(
        None,
        "--out-of-core",
        "keep observations and points in files in this folder, of a local disk; the result has the "
        "same bits. For BAL files and binary COLMAP models, without rounds and other inputs. The "
        "files have no names and end with the process",
        metavar="DIR",
        value="path",
    )
