"""`bundle demo`: refine the scene that the package carries, and write its report page.

The scene is a synthetic street of 32 images with 1 % gross outliers (data/street_colmap). The
command unpacks it into FOLDER/scene and runs `bundle refine` on it, so that the commands that the
report proposes work there, too.
"""

from __future__ import annotations

import argparse
import zipfile
from pathlib import Path

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.standard_streams import print_out
from bundle.errors import InputError, shown

_SCENE = Path(__file__).parent / "assets" / "street.zip"
_REFINE = ("--loss", "cauchy", "--rounds", "3", "--overwrite")


def run(arguments: argparse.Namespace) -> int:
    """Unpack the scene, refine it, and print the path of the page."""
    folder = Path(arguments.output)
    scene, refined, page = folder / "scene", folder / "refined", folder / "report.html"
    _unpack(folder, scene)
    words = ["refine", str(scene), "-o", f"{refined}/", "--html", str(page), *_REFINE]
    for flag in ("quiet", "verbose"):
        words += [f"--{flag}"] if getattr(arguments, flag) else []
    words += ["--json", arguments.json] if arguments.json else []
    from bundle.cli.main import main  # late: it imports the table of the commands

    code = main(words)
    if code == EXIT_DONE and arguments.json != "-":
        print_out(f"\nThe scene, the result and the page are in {shown(folder)}; open\n")
        print_out(f"  {page.absolute().as_uri()}\n")
    return code


def _unpack(folder: Path, scene: Path) -> None:
    """Write the scene, unless an earlier demo has done so.

    Raises:
        InputError: the folder has other files.
        OSError: a file cannot be written.
    """
    with zipfile.ZipFile(_SCENE) as packed:
        files = {name: packed.read(name) for name in packed.namelist()}
        if folder.is_dir() and all(_holds(scene / name, text) for name, text in files.items()):
            return
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise InputError(f"{shown(folder)}: expected a new or empty folder, found other files")
        packed.extractall(scene)


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content
