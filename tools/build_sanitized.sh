#!/usr/bin/env bash
# usage: tools/build_sanitized.sh SANITIZERS BUILD
#
# Builds the tests of the core in folder BUILD with these sanitizers, by clang: that a second compiler
# takes the core, without a warning, is thereby held too, and clang needs a third of GCC's time for
# sanitized kernels. Assertions of Eigen and of the standard library are on.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/debian.sh

install_packages clang libclang-rt-dev
cmake -S . -B "$2" -G Ninja --log-level=WARNING -DCMAKE_CXX_COMPILER=clang++ -DBUNDLE_SANITIZE="$1" \
  -DCMAKE_BUILD_TYPE=Sanitize -DCMAKE_CXX_FLAGS_SANITIZE="-O1 -g1" -DBUNDLE_WARNINGS_AS_ERRORS=ON \
  -DBUNDLE_PYTHON=OFF -DBUNDLE_CPP_TESTS=ON
cmake --build "$2" --target bundle_tests
