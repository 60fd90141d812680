"""Puts the licences of the libraries that a wheel carries into it.

    python tools/wheel_licences.py WHEEL LICENCES OUTPUT_FOLDER

LICENCES is the folder of texts that tools/wheel_libraries.sh fills; pybind11's is taken from the
environment that runs this. A library that is not in the table below ends it, as does a text that is
not found: nothing is shipped whose licence nobody has looked at.
"""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
import sys
import tempfile
from pathlib import Path

GCC = "licenses/libgcc/COPYING.RUNTIME"
# Of the libraries that the system gave: the SPDX expression, and where Debian and AlmaLinux
# (the system of manylinux images) keep the text.
SYSTEM: dict[str, tuple[str, list[str]]] = {
    "libbz2": (
        "bzip2-1.0.6",
        ["doc/libbz2-1.0/copyright", "licenses/bzip2-libs/LICENSE"],
    ),
    "libgfortran": (
        "GPL-3.0-or-later WITH GCC-exception-3.1",
        ["doc/libgfortran5/copyright", "licenses/libgfortran/COPYING.RUNTIME", GCC],
    ),
    "libopenblasp": (
        "BSD-3-Clause",
        ["doc/libopenblas0-pthread/copyright", "licenses/openblas/LICENSE"],
    ),
    "libquadmath": (
        "LGPL-2.1-or-later",
        ["doc/libquadmath0/copyright", "licenses/libquadmath/COPYING.LIB", GCC],
    ),
}
# Of those that tools/wheel_libraries.sh built: CHOLMOD with METIS, and what is in the module.
BUILT = {"libcholmod": "LGPL-2.1-or-later AND BSD-3-Clause AND Apache-2.0"}
STATIC = {
    "ceres": "BSD-3-Clause",
    "eigen": "MPL-2.0 AND BSD-3-Clause",
    "glog": "BSD-3-Clause",
    "rapidjson": "MIT AND BSD-3-Clause",
}
HEADERS = {"pybind11": "BSD-3-Clause"}  # packages of Python whose headers are in the module
OWN = "BSD-3-Clause AND MIT"  # ours, and three.js of the pages
GPL_3 = ["common-licenses/GPL-3", "licenses/libgcc/COPYING3"]


def expression(libraries: list[str]) -> str:
    """Return the SPDX expression of a wheel with these libraries, each term once."""
    known = BUILT | {name: terms for name, (terms, _) in SYSTEM.items()}
    unknown = sorted(set(libraries) - set(known))
    if unknown:
        sys.exit(f"error: libraries without a known licence: {', '.join(unknown)}")
    parts = [OWN, *STATIC.values(), *HEADERS.values(), *(known[name] for name in sorted(libraries))]
    return " AND ".join(dict.fromkeys(term for part in parts for term in part.split(" AND ")))


def first_of(names: list[str], share: Path) -> Path:
    """Return the first of these files that is there."""
    found = [share / name for name in names if (share / name).is_file()]
    if not found:
        sys.exit(f"error: no licence text: expected one of {', '.join(names)} in {share}")
    return found[0]


def installed_text(package: str) -> Path:
    """Return the licence of a Python package in this environment."""
    try:
        files = importlib.metadata.files(package) or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    found = [Path(str(file.locate())) for file in files if file.name == "LICENSE"]
    if not found:
        sys.exit(f"error: no licence text of {package} in the environment of {sys.executable}")
    return found[0]


def licence_files(libraries: list[str], built: Path, share: Path) -> dict[str, Path]:
    """Return the texts to add, by their name in the folder of licences."""
    files = {path.name: path for path in sorted(built.glob("*.txt"))}
    missing = [name for name in STATIC if not any(file.startswith(name) for file in files)]
    if missing:
        sys.exit(f"error: no licence text of {', '.join(missing)} in {built}")
    wanted = {name: SYSTEM[name][1] for name in sorted(libraries) if name in SYSTEM}
    if any(name in wanted for name in ("libgfortran", "libquadmath")):
        wanted["GPL-3.0"] = GPL_3
    files |= {f"{name}.txt": installed_text(name) for name in HEADERS}
    return files | {f"{name}.txt": first_of(places, share) for name, places in wanted.items()}


def rewrite_metadata(metadata: str, licence: str, names: list[str]) -> str:
    """Return METADATA with another expression and more licence files."""
    added = "".join(f"License-File: {name}\n" for name in names)
    terms = f"License-Expression: {licence}\n{added}"
    return re.sub(r"^License-Expression: .*\n", terms, metadata, flags=re.MULTILINE)


def main(wheel: Path, built: Path, output: Path) -> None:
    """Write the wheel with its licences into the output folder."""
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-m", "wheel"]
        subprocess.run([*command, "unpack", "--dest", scratch, str(wheel)], check=True)
        (root,) = Path(scratch).iterdir()
        (info,) = root.glob("*.dist-info")
        found = [path.name.split("-")[0] for path in root.glob("*.libs/*.so*")]
        files = licence_files(found, built, Path("/usr/share"))
        for name, source in files.items():
            target = info / "licenses" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read_bytes())
        metadata = info / "METADATA"
        text = metadata.read_text(encoding="utf-8")
        metadata.write_text(
            rewrite_metadata(text, expression(found), list(files)), encoding="utf-8"
        )
        subprocess.run([*command, "pack", "--dest-dir", str(output), str(root)], check=True)


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:4]))
