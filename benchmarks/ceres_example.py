"""Ceres' own examples/bundle_adjuster.cc, built at bench time from Debian's source package.

The source is that of the installed libceres-dev, got by `apt-get source` with lists of its own in
the cache folder: no root, and the system's configuration is left alone. Three statements are edited
(`EDITS`): the two tolerances that the example sets by hand, and what it writes at the end, so that
its final cost can be checked like everybody's. It is linked as `bundle` is: OpenBLAS ahead of the
ATLAS that Debian's Ceres would otherwise draw in.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from benchmarks.problems import CACHE

_FILES = (
    "bundle_adjuster.cc",
    "bal_problem.cc",
    "bal_problem.h",
    "random.h",
    "snavely_reprojection_error.h",
)
_KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
_SECONDS = 300.0

# What is replaced in bundle_adjuster.cc; each stands there exactly once. WriteToPLYFile has six
# digits and no distortion, WriteToFile all digits of every parameter.
EDITS = (
    ("options.gradient_tolerance = 1e-16;", "options.gradient_tolerance = {gradient};"),
    (
        "options.function_tolerance = 1e-16;",
        "options.function_tolerance = {function};\n  options.parameter_tolerance = {parameter};",
    ),
    (
        "bal_problem.WriteToPLYFile(CERES_GET_FLAG(FLAGS_final_ply));",
        "bal_problem.WriteToFile(CERES_GET_FLAG(FLAGS_final_ply));",
    ),
)
_TOLERANCE = 'std::atof(std::getenv("{name}_TOLERANCE"))'

_CMAKE = """cmake_minimum_required(VERSION 3.25)
project(ceres_example CXX)
find_package(Ceres REQUIRED)
add_executable(bundle_adjuster bundle_adjuster.cc bal_problem.cc)
target_link_libraries(bundle_adjuster PRIVATE -Wl,--no-as-needed openblas Ceres::ceres gflags)
"""


class UnavailableError(Exception):
    """The example cannot be had here; the message is the row's reason."""


def edited(source: str) -> str:
    """Return bundle_adjuster.cc with the tolerances read from the environment.

    Raises:
        UnavailableError: the source is not the one that the edits were written for.
    """
    values = {
        name: _TOLERANCE.format(name=name.upper()) for name in ("gradient", "function", "parameter")
    }
    for old, new in EDITS:
        if source.count(old) != 1:
            raise UnavailableError(f"the example has changed: expected one {old!r}")
        source = source.replace(old, new.format(**values))
    return source


def binary() -> Path:
    """Return the built example, building it if it is missing.

    Raises:
        UnavailableError: no Debian package, no network, no compiler, another source; one line.
    """
    if shutil.which("apt-get") is None or shutil.which("dpkg-query") is None:
        raise UnavailableError("no Debian source packages here")
    version = _run(["dpkg-query", "-W", "-f=${source:Version}", "libceres-dev"])
    folder = CACHE / f"ceres-example-{version}"
    built = folder / "build" / "bundle_adjuster"
    if not built.exists():
        _prepare(folder, version)
        for step in (["-S", str(folder), "-B", str(built.parent)], ["--build", str(built.parent)]):
            release = ["-DCMAKE_BUILD_TYPE=Release"] if step[0] == "-S" else []
            _run(["cmake", *step, *release])
    return built


@cache
def reason_missing() -> str:
    """Return why there is no example, "" if there is; the first call may build it."""
    try:
        binary()
    except UnavailableError as reason:
        return f"not built: {reason}"
    return ""


def _prepare(folder: Path, version: str) -> None:
    """Fill the folder with the example's files and a CMakeLists.txt."""
    package = folder / "package"
    shutil.rmtree(folder, ignore_errors=True)
    package.mkdir(parents=True)
    apt = _apt(folder / "apt")
    _run([*apt, "update", "-qq"])
    _run([*apt, "source", "-qq", f"ceres-solver={version}"], cwd=package)
    (examples,) = package.glob("ceres-solver-*/examples")
    for name in _FILES:
        shutil.copy(examples / name, folder / name)
    main = folder / "bundle_adjuster.cc"
    main.write_text(edited(main.read_text()))
    (folder / "CMakeLists.txt").write_text(_CMAKE)


def _apt(folder: Path) -> list[str]:
    """Return apt-get with lists and sources of its own."""
    (folder / "lists" / "partial").mkdir(parents=True)
    (folder / "archives" / "partial").mkdir(parents=True)
    release = dict(
        line.split("=", 1)
        for line in Path("/etc/os-release").read_text().splitlines()
        if "=" in line
    )
    suite = release.get("VERSION_CODENAME", "").strip('"')
    if release.get("ID", "").strip('"') != "debian" or not suite or not _KEYRING.exists():
        raise UnavailableError("no Debian source packages here")
    sources = folder / "sources.list"
    sources.write_text(
        f"deb-src [signed-by={_KEYRING}] http://deb.debian.org/debian {suite} main\n"
    )
    settings = {
        "Dir::State::lists": folder / "lists",
        "Dir::Etc::sourcelist": sources,
        "Dir::Etc::sourceparts": "-",
        "Dir::Cache": folder,
    }
    return ["apt-get", *(f"-o{name}={value}" for name, value in settings.items())]


def _run(command: Sequence[str], cwd: Path | None = None) -> str:
    """Run a command and return what it says; its last line is the reason if it fails."""
    # cmake may be that of the virtual environment.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    env = {**os.environ, "PATH": path, "LC_ALL": "C"}
    try:
        done = subprocess.run(
            command, cwd=cwd, env=env, capture_output=True, text=True, timeout=_SECONDS
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnavailableError(f"{command[0]}: {error}".splitlines()[0]) from None
    if done.returncode:
        words = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()
        raise UnavailableError(f"{command[0]}: {words[-1]}")
    return done.stdout.strip()
