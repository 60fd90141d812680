"""One run of ``benchmarks.uncertainty``: reads a request, writes an answer, both JSON files.

Who "make" writes a street.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.runners import protocol
from benchmarks.uncertainty import DIAGNOSIS, INFLUENCE, POSES, RELIABILITY, THEIRS, TWO_CAMERAS


def make(path: str, scene: dict[str, Any]) -> None:
    """Write a street where it truly is, with the noise of its observations."""
    import bundle

    bundle.save(bundle.synthesize(**scene).ground_truth, path, "colmap")


def ours(request: dict[str, Any]) -> Callable[[], object]:
    """Return what is to be measured, of a problem that is loaded."""
    import bundle

    problem = bundle.load(request["path"])
    threads = request["threads"]
    if request["who"] == DIAGNOSIS:
        diagnose = bundle.diagnose  # imports its module, which is not measured
        return lambda: diagnose(problem, num_threads=threads)
    if request["who"] == RELIABILITY:
        reliability = bundle.reliability
        return lambda: reliability(problem, num_threads=threads)
    if request["who"] == INFLUENCE:
        influence, ids = bundle.influence, problem.image_ids
        on = f"baseline {ids[0]} {ids[len(ids) // 2]} / baseline {ids[1]} {ids[-1]}"
        return lambda: influence(problem, on, num_threads=threads)
    of = ("poses",) if request["who"] == POSES else ("poses", "points", "intrinsics")
    gauge = "two-cameras" if request["who"] == TWO_CAMERAS else "inner"
    covariance = bundle.covariance
    return lambda: covariance(problem, of=of, gauge=gauge, num_threads=threads)


def theirs(request: dict[str, Any]) -> Callable[[], object]:
    """Return the same by pycolmap, whose problem is built."""
    import pycolmap

    reconstruction = pycolmap.Reconstruction(request["path"])
    chosen = pycolmap.BundleAdjustmentOptions()
    # Below this number of residuals COLMAP drops to one thread.
    chosen.ceres.min_num_residuals_for_cpu_multi_threading = 0
    solver: Any = chosen.ceres.solver_options
    solver.num_threads = request["threads"]
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster: Any = pycolmap.create_default_ceres_bundle_adjuster(chosen, config, reconstruction)
    wanted: Any = pycolmap.BACovarianceOptions()
    wanted.params = pycolmap.BACovarianceOptionsParams.ALL

    def estimate() -> None:
        if pycolmap.estimate_ba_covariance(wanted, reconstruction, adjuster) is None:
            raise RuntimeError("estimate_ba_covariance returned no covariance")

    return estimate


def cpu() -> float:
    """Return the seconds that all threads of this process have used."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Answer the request; a failure is an answer too."""
    asked, answered = map(Path, sys.argv[1:3])
    request = json.loads(asked.read_text())
    protocol.pin(request["threads"])
    answer: dict[str, Any] = {"failure": ""}
    try:
        if request["who"] == "make":
            make(request["path"], request["scene"])
        else:
            run = (theirs if request["who"] == THEIRS else ours)(request)
            if request["who"] in (POSES, RELIABILITY, INFLUENCE):
                run()  # what a first call imports is not compared
            begun, used = time.perf_counter(), cpu()
            run()
            answer |= {"wall": time.perf_counter() - begun, "cpu": cpu() - used}
            unit = 1 if sys.platform == "darwin" else 1024
            answer["memory"] = unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    except Exception as error:  # a failed run is a row, not the end of the benchmark
        answer = {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    answered.write_text(json.dumps(answer))


if __name__ == "__main__":
    main()
