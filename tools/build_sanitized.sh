#!/usr/bin/env bash
# usage: tools/build_sanitized.sh COMPILER SANITIZERS BUILD
#
# Builds the tests of the core in folder BUILD with these sanitizers. Assertions of Eigen and of the
# standard library are on. Warnings are errors, but for those of GCC's that follow the flow of data: under
# sanitizers these are false alarms.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/debian.sh

flags="-O1 -g1"
if [[ "$1" == clang++ ]]; then
  install_packages clang libclang-rt-dev
else
  for warning in maybe-uninitialized array-bounds stringop-overflow stringop-overread null-dereference; do
    flags+=" -Wno-error=$warning"
  done
fi
# The tests run the kernels of the baseline and of the best instruction set that the machine has.
sets=avx2
! grep -qs avx512vl /proc/cpuinfo || sets=avx512
cmake -S . -B "$3" -G Ninja --log-level=WARNING -DCMAKE_CXX_COMPILER="$1" -DBUNDLE_SANITIZE="$2" \
  -DCMAKE_BUILD_TYPE=Sanitize -DCMAKE_CXX_FLAGS_SANITIZE="$flags" -DBUNDLE_WARNINGS_AS_ERRORS=ON \
  -DBUNDLE_INSTRUCTION_SETS="$sets" -DBUNDLE_PYTHON=OFF -DBUNDLE_CPP_TESTS=ON
cmake --build "$3" --target bundle_tests
