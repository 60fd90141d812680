"""Puts the licences of the libraries that a wheel carries into it.

    python tools/wheel_licences.py WHEEL SUITESPARSE_SOURCE OUTPUT_FOLDER

Run by tools/build_wheel.sh. A library that is not in the table below ends it: nothing is shipped
whose licence nobody has looked at.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

DOCUMENTS = Path("/usr/share/doc")
COMMON = Path("/usr/share/common-licenses")

# By the library's name: Debian's package whose copyright file is its licence (None: SuiteSparse's
# own texts, as it is built from source), and the SPDX expression.
LIBRARIES: dict[str, tuple[str | None, str]] = {
    "libbz2": ("libbz2-1.0", "bzip2-1.0.6"),
    "libcholmod": (None, "LGPL-2.1-or-later AND BSD-3-Clause AND Apache-2.0"),
    "libcxsparse": ("libcxsparse3", "LGPL-2.1-or-later"),
    "libgflags": ("libgflags2.2", "BSD-3-Clause"),
    "libgfortran": ("libgfortran5", "GPL-3.0-or-later WITH GCC-exception-3.1"),
    "libglog": ("libgoogle-glog0v6", "BSD-3-Clause"),
    "liblzma": ("liblzma5", "LicenseRef-Public-Domain"),
    "libopenblasp": ("libopenblas0-pthread", "BSD-3-Clause"),
    "libquadmath": ("libquadmath0", "LGPL-2.1-or-later"),
    "libunwind": ("libunwind8", "MIT"),
}
# Compiled into the module itself.
STATIC = {
    "libceres-dev": "BSD-3-Clause",
    "libeigen3-dev": "MPL-2.0 AND BSD-3-Clause",
}
OWN = "BSD-3-Clause AND MIT"  # ours, and three.js of the pages
SUITESPARSE = [
    "CHOLMOD/Doc/License.txt",
    "AMD/Doc/License.txt",
    "CAMD/Doc/License.txt",
    "COLAMD/Doc/License.txt",
    "CCOLAMD/Doc/License.txt",
    "metis-5.1.0/LICENSE.txt",
]
TEXTS = ["LGPL-2.1", "GPL-3", "MPL-2.0", "Apache-2.0"]


def expression(libraries: list[str]) -> str:
    """Return the SPDX expression of a wheel with these libraries, each term once."""
    unknown = sorted(set(libraries) - set(LIBRARIES))
    if unknown:
        sys.exit(f"error: libraries without a known licence: {', '.join(unknown)}")
    parts = [OWN, *STATIC.values(), *(LIBRARIES[name][1] for name in sorted(libraries))]
    return " AND ".join(dict.fromkeys(term for part in parts for term in part.split(" AND ")))


def licence_files(libraries: list[str], suitesparse: Path) -> dict[str, Path]:
    """Return the texts to add, by their name in the folder of licences."""
    packages = [*STATIC, *(LIBRARIES[name][0] for name in sorted(libraries))]
    files = {f"{name}.txt": DOCUMENTS / name / "copyright" for name in packages if name}
    files |= {f"suitesparse/{name.replace('/', '-')}": suitesparse / name for name in SUITESPARSE}
    return files | {f"texts/{name}.txt": COMMON / name for name in TEXTS}


def rewrite_metadata(metadata: str, licence: str, names: list[str]) -> str:
    """Return METADATA with another expression and more licence files."""
    added = "".join(f"License-File: {name}\n" for name in names)
    terms = f"License-Expression: {licence}\n{added}"
    return re.sub(r"^License-Expression: .*\n", terms, metadata, flags=re.MULTILINE)


def main(wheel: Path, suitesparse: Path, output: Path) -> None:
    """Write the wheel with its licences into the output folder."""
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-m", "wheel"]
        subprocess.run([*command, "unpack", "--dest", scratch, str(wheel)], check=True)
        (root,) = Path(scratch).iterdir()
        (info,) = root.glob("*.dist-info")
        found = [path.name.split("-")[0] for path in root.glob("*.libs/*.so*")]
        files = licence_files(found, suitesparse)
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
