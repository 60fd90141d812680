#!/usr/bin/env bash
# usage: tools/setup.sh PYTHON VENV EXTRAS
#
# Installs the Debian packages that are missing (and only then touches apt), makes the virtual
# environment, and installs bundle into it in editable mode: Python sources are used where they
# stand, the C++ core is compiled incrementally in build/.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=$1
venv=$2
extras=$3

die() {
  echo "error: $*" >&2
  exit 2
}

require_python() {
  command -v "$python" >/dev/null ||
    die "$python: not found; install Python 3.11 or newer, or name one: make PYTHON=python3.12 setup"
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    die "$python: expected Python 3.11 or newer, found $("$python" --version 2>&1);" \
      "name another: make PYTHON=python3.12 setup"
}

# One package a line. Debian splits its own Python into packages; any other Python is whole.
wanted_packages() {
  printf '%s\n' g++ libceres-dev libsuitesparse-dev libopenblas-dev libbz2-dev zlib1g-dev \
    libgtest-dev
  "$python" - <<'PY'
import sys

if sys.base_prefix == "/usr":
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    print(f"{name}-venv", f"{name}-dev", sep="\n")
PY
}

is_installed() {
  [[ "$(dpkg-query -W -f='${Status}' "$1" 2>/dev/null)" == "install ok installed" ]]
}

install_packages() {
  if ! command -v apt-get >/dev/null; then
    echo "no apt-get here: taking it that a C++17 compiler, Ceres, SuiteSparse, OpenBLAS, bzip2," \
      "zlib and GoogleTest are installed" >&2
    return
  fi
  local missing=() package
  for package in $(wanted_packages); do
    is_installed "$package" || missing+=("$package")
  done
  [[ ${#missing[@]} -gt 0 ]] || return 0
  can_install ||
    die "missing Debian packages and neither root nor sudo to install them: ${missing[*]}"
  apt_install "${missing[@]}"
}

can_install() {
  [[ $(id -u) -eq 0 ]] || command -v sudo >/dev/null
}

apt_install() {
  local as_root=(env DEBIAN_FRONTEND=noninteractive)
  [[ $(id -u) -eq 0 ]] || as_root=(sudo "${as_root[@]}")
  echo "installing $*"
  # One broken third-party source fails the update as a whole; Debian's own lists may be fine.
  "${as_root[@]}" apt-get update -qq || echo "apt-get update failed; trying the lists at hand" >&2
  "${as_root[@]}" apt-get install -y -qq --no-install-recommends "$@"
}

# Tests open the pages that bundle writes in a browser, 64 MB to fetch, and are skipped without one:
# all else works, so that no browser is no error.
install_browser() {
  local name
  for name in chromium-headless-shell chromium chromium-browser google-chrome; do
    ! command -v "$name" >/dev/null || return 0
  done
  { command -v apt-get >/dev/null && can_install && apt_install chromium-headless-shell; } ||
    echo "no Chromium to test pages in: these tests will be skipped" >&2
}

# A half-made environment, or one of another Python, is made anew.
make_venv() {
  local identity='import ensurepip, sys; print(sys.version, sys.base_prefix)'
  [[ "$("$venv/bin/python" -c "import pip; $identity" 2>/dev/null)" == "$("$python" -c "$identity")" ]] ||
    "$python" -m venv --clear "$venv"
}

# Without build isolation the build tree keeps its paths, so that a changed source compiles alone.
install_bundle() {
  export PIP_DISABLE_PIP_VERSION_CHECK=1 PATH="$PWD/$venv/bin:$PATH"
  local requires=()
  mapfile -t requires < <("$venv/bin/python" -c '
import pathlib, tomllib
project = tomllib.loads(pathlib.Path("pyproject.toml").read_text())
print(*project["build-system"]["requires"], sep="\n")')
  "$venv/bin/python" -m pip install --quiet "${requires[@]}" "cmake>=3.25" ninja
  "$venv/bin/python" -m pip install --quiet --no-build-isolation --editable ".[$extras]"
}

require_python
install_packages
install_browser
make_venv
install_bundle
"$venv/bin/python" -c 'import bundle; print(f"bundle {bundle.__version__} is ready in '"$venv"'")'
