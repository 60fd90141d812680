#!/usr/bin/env bash
# usage: tools/try_install.sh OUT [PYTHON]...
#
# Builds the source archive, and from it a wheel for each PYTHON, into OUT; checks their metadata;
# installs each wheel into two fresh environments, with pycolmap and without it, and tries both.
# These wheels use the libraries of the system; tools/build_wheel.sh makes one that carries its own.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=$(mkdir -p "$1" && cd "$1" && pwd)
shift
[[ $# -gt 0 ]] || set -- python3
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_QUIET=1

rm -f "$out"/*.tar.gz "$out"/*.whl
"$1" -m venv --clear "$out/tools"
"$out/tools/bin/python" -m pip install "build==1.6.1" "twine==7.0.0"
"$out/tools/bin/python" -m build --sdist --outdir "$out" . >/dev/null
for python; do
  tag=$("$python" -c 'import sys; print(f"cp{sys.version_info.major}{sys.version_info.minor}")')
  "$python" -m venv --clear "$out/$tag"
  "$out/$tag/bin/python" -m pip wheel --no-deps --wheel-dir "$out" "$out"/*.tar.gz
  "$out/$tag/bin/python" -m pip install "$out"/*-"$tag"-*.whl
  echo "$("$python" --version), pycolmap $("$out/$tag/bin/python" -c 'import pycolmap; print(pycolmap.__version__)')"
  bash tools/try_wheel.sh "$out/$tag/bin" data
  "$out/$tag/bin/python" -m pip uninstall --yes pycolmap
  ! "$out/$tag/bin/python" -c 'import pycolmap' 2>/dev/null
  echo "$("$python" --version), without pycolmap"
  bash tools/try_wheel.sh "$out/$tag/bin" data
done
"$out/tools/bin/twine" check --strict "$out"/*.tar.gz "$out"/*.whl
