"""`bundle refine MODEL -o OUTPUT` through pycolmap, in the fewest lines and imports that do it.

Arguments: INPUT and OUTPUT (folders), then threads, iterations and the three tolerances. Run as a
script, so that nothing but pycolmap is imported. Prints nothing.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import pycolmap

source, target, threads, iterations, function, gradient, parameter = sys.argv[1:]
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(threads)])
reconstruction = pycolmap.Reconstruction(source)
options = pycolmap.BundleAdjustmentOptions()
options.print_summary = False
# Below this number of residuals COLMAP drops to one thread.
options.ceres.min_num_residuals_for_cpu_multi_threading = 0
solver: Any = options.ceres.solver_options
solver.num_threads = int(threads)
solver.max_num_iterations = int(iterations)
solver.function_tolerance = float(function)
solver.gradient_tolerance = float(gradient)
solver.parameter_tolerance = float(parameter)
config = pycolmap.BundleAdjustmentConfig()
for image_id in reconstruction.reg_image_ids():
    config.add_image(image_id)
config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction).solve()
reconstruction.update_point_3d_errors()
os.mkdir(target)  # noqa: PTH102 (pathlib would be one more import)
reconstruction.write_binary(target)
