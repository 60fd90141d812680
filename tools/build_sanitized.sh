#!/usr/bin/env bash
# usage: tools/build_sanitized.sh COMPILER SANITIZERS BUILD
#
# Builds the tests of the core in folder BUILD with these sanitizers. Assertions of Eigen and of the
# standard library are on. Clang's warnings are errors; GCC's are so in `make lint`, and false alarms under
# sanitizers.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/debian.sh

strict=OFF
if [[ "$1" == clang++ ]]; then
  install_packages clang libclang-rt-dev
  strict=ON
fi
cmake -S . -B "$3" -G Ninja --log-level=WARNING -DCMAKE_CXX_COMPILER="$1" -DBUNDLE_SANITIZE="$2" \
  -DCMAKE_BUILD_TYPE=Sanitize -DCMAKE_CXX_FLAGS_SANITIZE="-O1 -g1" -DBUNDLE_WARNINGS_AS_ERRORS="$strict" \
  -DBUNDLE_PYTHON=OFF -DBUNDLE_CPP_TESTS=ON
cmake --build "$3" --target bundle_tests
