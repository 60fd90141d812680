#!/usr/bin/env bash
# usage: tools/setup.sh PYTHON VENV [EXTRAS]
#
# Installs the Debian packages that are missing (and only then touches apt), makes the virtual
# environment, and installs bundle into it in editable mode: Python sources are used where they
# stand, the C++ core is compiled incrementally in build/.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/debian.sh

python=$1
venv=$2
extras=${3:-}

# Targets that need different extras may run at a time (make --jobs): one environment after the other.
exec 9<tools/setup.sh
flock 9

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
    rapidjson-dev libgtest-dev
  "$python" - <<'PY'
import sys

if sys.base_prefix == "/usr":
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    print(f"{name}-venv", f"{name}-dev", sep="\n")
PY
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
  # Under its former name, bundle would own the same files, and uninstalling it later would take them.
  "$venv/bin/python" -m pip uninstall --quiet --quiet --yes bundle
  # Python compiles what it imports; pip would compile the rest, too.
  "$venv/bin/python" -m pip install --quiet --no-compile "${requires[@]}" "cmake>=3.25" ninja
  "$venv/bin/python" -m pip install --quiet --no-compile --no-build-isolation \
    --editable ".${extras:+[$extras]}"
}

require_python
mapfile -t packages < <(wanted_packages)
install_packages "${packages[@]}"
[[ ",$extras," != *,test,* ]] || install_browser
make_venv
install_bundle
"$venv/bin/python" -c 'import bundle; print(f"bundle {bundle.__version__} is ready in '"$venv"'")'
