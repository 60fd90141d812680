#!/usr/bin/env bash
# usage: tools/try_wheel.sh BIN DATA
#
# Tries an installed bundle, that of the folder BIN of an environment, on the models in DATA: both
# backends, covariance, a pose graph, a check. Needs nothing of this repository but DATA.
set -euo pipefail
bin=$(cd "$1" && pwd)
data=$(cd "$2" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cd "$scratch" # a folder without a bundle/ that Python would import
# Every symbol is looked up at the start: one that a library left out ends it.
export LD_BIND_NOW=1

# Together with pycolmap, whose libraries must not meet ours; some machines have no wheel of it.
"$bin/python" - <<'PY'
import contextlib

with contextlib.suppress(ModuleNotFoundError):
    import pycolmap  # noqa: F401
import bundle

print("bundle", bundle.__version__, bundle.__file__)
PY
"$bin/bundle" --version
refine() { "$bin/bundle" refine "$data/street_colmap" --quiet --loss cauchy "$@" >/dev/null; }
start=$(date +%s%N)
"$bin/bundle" demo demo --quiet >demo.txt
echo "bundle demo: $((($(date +%s%N) - start) / 1000000)) ms"
grep -q "^  file://.*/demo/report.html$" demo.txt && test -s demo/report.html
refine -o fused --backend fused --json fused.json
refine -o ceres --backend ceres --solver sparse_schur --json ceres.json
refine -o dense --backend ceres --solver dense_schur --json dense.json
"$bin/bundle" covariance "$data/street_colmap" -o covariance.npz --quiet >/dev/null
"$bin/bundle" check "$data/orbit_bal.txt.bz2" --quiet >/dev/null
"$bin/bundle" merge "$data/street_colmap" fused -o merged --quiet >/dev/null
information='1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1'
{
  printf 'VERTEX_SE3:QUAT %d %s 0 0 0 0 0 1\n' 0 0 1 1.2 2 2.1
  printf "EDGE_SE3:QUAT %d %d 1 0 0 0 0 0 1 $information\n" 0 1 1 2
} >line.g2o
"$bin/bundle" refine line.g2o -o refined.g2o --quiet >/dev/null

"$bin/python" - <<'PY'
import json
import math
import pathlib

costs = [
    json.loads(pathlib.Path(f"{name}.json").read_text())["summary"]["final_cost"]
    for name in ("fused", "ceres", "dense")
]
assert all(math.isclose(cost, costs[0], rel_tol=1e-6) for cost in costs), costs
lines = pathlib.Path("refined.g2o").read_text().splitlines()
vertices = [line.split() for line in lines if line.startswith("VERTEX")]
assert [round(float(row[2]), 9) for row in vertices] == [0, 1, 2], vertices
print("tried: all well")
PY
