"""Memory that a solve adds to its process, in bytes an observation."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import bundle

# Prints how far the process grows beyond the loaded problem, as benchmarks/runners measure it.
MEASURE = """
import sys
from pathlib import Path
import bundle

def status(field):
    text = Path("/proc/self/status").read_text()
    return 1024 * int(text.split(f"{field}:")[1].split()[0])

problem = bundle.load(sys.argv[1])
Path("/proc/self/clear_refs").write_text("5")  # restarts the peak
loaded = status("VmRSS")
summary = bundle.solve(
    problem,
    backend="fused",
    linear_solver_type=sys.argv[2],
    num_threads=2,
    max_num_iterations=3,
).summary
assert summary.num_linear_solves == 3
print((status("VmHWM") - loaded) / problem.num_observations)
"""


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 400 images with 1000 observations each, every image with its own intrinsics."""
    scene = bundle.synthesize(
        scene="street",
        num_images=400,
        num_points=80_000,
        mean_track_length=5.0,
        camera_model="RADIAL",
        cameras="individual",
        seed=4,
    )
    path = tmp_path_factory.mktemp("memory") / "street.txt"
    bundle.save(scene.problem, path)
    return path


# Measured: 129 and 113, of which the memory of tiles (10), large pages (page_arena.h, 4) and more
# do not grow with the observations.
# 13 of the 129 are what rounding takes from S (double_double.h), 18 are lists of pairs
# (elimination_plan.h). While the sparse solver had a copy of S and its indices
# beside the factor, it took 128 without these.
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is read from /proc")
@pytest.mark.parametrize(("solver", "bound"), [("sparse_schur", 134), ("iterative_schur", 118)])
def test_bytes_an_observation(street: Path, solver: str, bound: float) -> None:
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, street, solver],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert float(done.stdout) < bound


# Prints the addresses of refined points and the mappings with large pages.
PLACES = """
import re
from pathlib import Path
import bundle

problem = bundle.synthesize(num_images=12, num_points=2000, seed=1).problem
kept = [bundle.solve(problem, backend="fused", max_num_iterations=2).problem for _ in range(3)]
places = [refined.points.__array_interface__["data"][0] for refined in kept]
assert kept[0].points.nbytes > 1 << 14  # an array of a solve, of this size, is there
mappings = re.findall(
    r"^([0-9a-f]+)-([0-9a-f]+) (?:.*\\n)+?VmFlags:(.*)$", Path("/proc/self/smaps").read_text(), re.M
)
large = [(int(begin, 16), int(end, 16)) for begin, end, flags in mappings if "hg" in flags.split()]
print(len(large), sum(begin <= place < end for place in places for begin, end in large))
"""


@pytest.mark.skipif(
    not Path("/sys/kernel/mm/transparent_hugepage").exists(), reason="a system without large pages"
)
def test_results_do_not_hold_the_pages_of_solves() -> None:
    # In a process of its own, whose heap has no hint for large pages.
    done = subprocess.run(
        [sys.executable, "-c", PLACES], capture_output=True, text=True, check=True, timeout=300
    )
    large, held = (int(count) for count in done.stdout.split())
    assert large >= 1
    assert held == 0
