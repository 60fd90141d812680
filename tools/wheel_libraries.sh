#!/usr/bin/env bash
# usage: tools/wheel_libraries.sh PREFIX
#
# Builds what a wheel carries and no distribution offers without the GPL: CHOLMOD and, static, Ceres
# with Eigen and glog, into PREFIX, with their licences in PREFIX/licences. RapidJSON's headers come
# along: not each distribution has them. OpenBLAS, bzip2 and zlib are the system's, which are under
# licences that ask for less. What stands there already is kept.
# Needs a C++ compiler, cmake, make, curl, tar, bzip2, xz and OpenBLAS's headers.
#
# CHOLMOD's modules Supernodal, MatrixOps and Modify and all of SPQR are under the GPL. Our own code
# needs neither. Ceres has a path around the supernodal module, and SPQR serves its class Covariance
# alone, of which we make no use: both are left out.
set -euo pipefail
mkdir -p "$1"
prefix=$(cd "$1" && pwd)
work=$prefix/work
# Debian's server keeps these as long as Debian 12 lasts; they are the projects' own releases.
debian=https://deb.debian.org/debian/pool/main

# fetch FOLDER PATH SHA256 [MEMBER...]: unpack a release into FOLDER
fetch() {
  local folder=$work/$1 url=$debian/$2 sum=$3
  shift 3
  [[ ! -d "$folder" ]] || return 0
  rm -rf "$folder.part" && mkdir -p "$folder.part"
  curl --fail --silent --show-error --location --retry 3 --output "$folder.tar" "$url"
  echo "$sum  $folder.tar" | sha256sum --check --quiet
  tar --extract --file "$folder.tar" --directory "$folder.part" --strip-components=1 --wildcards "$@"
  mv "$folder.part" "$folder"
}

# licence NAME FILE: keep a text under its library's name
licence() { mkdir -p "$prefix/licences" && cp "$2" "$prefix/licences/$1.txt"; }

# One command a line: every module in its two widths of index, METIS once.
compile_cholmod() {
  local s=$work/suitesparse module file name width metis=$work/suitesparse/metis-5.1.0
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
  fetch suitesparse s/suitesparse/suitesparse_5.12.0+dfsg.orig.tar.xz \
    bb106c43049138c19675cd70322e72ff8e4fd8bdcab3a096307fd78488913faf \
    '*/SuiteSparse_config' '*/metis-5.1.0' '*/AMD' '*/CAMD' '*/COLAMD' '*/CCOLAMD' '*/CHOLMOD'
  local s=$work/suitesparse library=$prefix/lib/libcholmod.so.3 part
  for part in CHOLMOD AMD CAMD COLAMD CCOLAMD; do
    licence "suitesparse-$part" "$s/$part/Doc/License.txt"
  done
  licence suitesparse-METIS "$s/metis-5.1.0/LICENSE.txt"
  licence LGPL-2.1 "$s/AMD/Doc/lesser.txt"
  [[ ! -f "$library" ]] || return 0
  rm -rf "$work/objects" && mkdir -p "$work/objects" "$prefix/lib" "$prefix/include/suitesparse"
  (cd "$work/objects" && compile_cholmod | xargs -P 2 -I{} sh -c '{}')
  cp "$s"/SuiteSparse_config/*.h "$s"/{AMD,CAMD,COLAMD,CCOLAMD,CHOLMOD}/Include/*.h \
    "$prefix/include/suitesparse"
  # Under the names by which Ceres looks for its parts, too.
  for part in cholmod amd camd colamd ccolamd suitesparseconfig; do
    ln -sf libcholmod.so.3 "$prefix/lib/lib$part.so"
  done
  gcc -shared -Wl,-soname,libcholmod.so.3 -Wl,--no-undefined -o "$library.part" "$work"/objects/*.o -lm
  mv "$library.part" "$library"
}

# with_cmake FOLDER [OPTION...]: configure, build and install the sources in FOLDER
with_cmake() {
  local folder=$work/$1
  shift
  mkdir -p "$folder/build"
  {
    cmake -S "$folder" -B "$folder/build" -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX="$prefix" \
      -DCMAKE_INSTALL_LIBDIR=lib -DCMAKE_PREFIX_PATH="$prefix" -DCMAKE_POSITION_INDEPENDENT_CODE=ON \
      -DCMAKE_POLICY_VERSION_MINIMUM=3.5 -DBUILD_SHARED_LIBS=OFF -DBUILD_TESTING=OFF "$@" &&
      cmake --build "$folder/build" --parallel 2 --target install
  } &>"$folder/build/log" || { tail -20 "$folder/build/log" >&2 && exit 1; }
}

build_eigen() {
  fetch eigen e/eigen3/eigen3_3.4.0.orig.tar.bz2 \
    b4c198460eba6f28d34894e3a5710998818515104d6e74e5cc331ce31e46e626
  licence eigen-MPL-2.0 "$work/eigen/COPYING.MPL2"
  licence eigen-BSD-3-Clause "$work/eigen/COPYING.BSD"
  licence Apache-2.0 "$work/eigen/COPYING.APACHE" # of METIS; its own file only names it
  [[ -d "$prefix/share/eigen3" ]] || with_cmake eigen -DEIGEN_BUILD_DOC=OFF
}

# Headers alone.
build_rapidjson() {
  fetch rapidjson r/rapidjson/rapidjson_1.1.0+dfsg2.orig.tar.gz \
    92aa6402743012e5f2c3db17def1ff5273df4f3ca7a8f8ed9f1041d392c14ce7
  licence rapidjson "$work/rapidjson/license.txt"
  mkdir -p "$prefix/include" && cp -r "$work/rapidjson/include/rapidjson" "$prefix/include"
}

build_glog() {
  fetch glog g/google-glog/google-glog_0.6.0.orig.tar.gz \
    8a83bf982f37bb70825df71a9709fa90ea9f4447fb3c099e1d720a439d88bad6
  licence glog "$work/glog/COPYING"
  [[ ! -f "$prefix/lib/libglog.a" ]] || return 0
  # Thread-local storage: 30 KB, for which a module that is loaded late finds no place.
  with_cmake glog -DWITH_TLS=OFF -DWITH_GFLAGS=OFF -DWITH_GTEST=OFF -DWITH_UNWIND=OFF
}

# Takes SPQR out of the sources: not asked for, not linked, not included, not called.
leave_out_spqr() {
  cd "$work/ceres"
  sed -i 's/COMPONENTS CHOLMOD SPQR/COMPONENTS CHOLMOD/; s/find_dependency(SuiteSparse ${SuiteSparse_VERSION})/find_dependency(SuiteSparse ${SuiteSparse_VERSION} COMPONENTS CHOLMOD)/' CMakeLists.txt
  sed -i '/LIBRARY_PRIVATE_DEPENDENCIES SuiteSparse::CHOLMOD$/{N; s/\n *SuiteSparse::SPQR//}' \
    internal/ceres/CMakeLists.txt
  sed -i '/SuiteSparseQR.hpp/d' internal/ceres/suitesparse.h
  sed -i 's/^#if !defined(CERES_NO_SUITESPARSE)$/#if 0/; s/^#ifndef CERES_NO_SUITESPARSE$/#if 0/' \
    internal/ceres/covariance_impl.cc
}

build_ceres() {
  fetch ceres c/ceres-solver/ceres-solver_2.1.0+really2.1.0+dfsg.orig.tar.xz \
    acd5774187a8ea92bdf9e6d1faeb22c00bf30b1ad226ef6e2ade8b7636bbc336
  licence ceres "$work/ceres/LICENSE"
  [[ ! -f "$prefix/lib/libceres.a" ]] || return 0
  (leave_out_spqr)
  with_cmake ceres -DGFLAGS=OFF -DCXSPARSE=OFF -DCUDA=OFF -DSUITESPARSE=ON -DBUILD_EXAMPLES=OFF \
    -DBUILD_BENCHMARKS=OFF -DBUILD_DOCUMENTATION=OFF -DPROVIDE_UNINSTALL_TARGET=OFF \
    -DBLA_VENDOR=OpenBLAS ${OPENBLAS:+-DBLAS_LIBRARIES="$OPENBLAS" -DLAPACK_LIBRARIES="$OPENBLAS"}
  # Without SuiteSparse it would be built as well, and refuse --backend ceres with a sparse solver.
  grep -q '^#define CERES_NO_CXSPARSE' "$prefix/include/ceres/internal/config.h"
  ! grep -q '^#define CERES_NO_SUITESPARSE' "$prefix/include/ceres/internal/config.h"
}

build_cholmod
build_eigen
build_rapidjson
build_glog
build_ceres
