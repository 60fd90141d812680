"""Drop-in for ``pycolmap.bundle_adjustment``."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

from bundle.base.log_messages import log
from bundle.base.optional_packages import require_pycolmap
from bundle.base.records import dataclass
from bundle.interface.colmap_options import colmap_adjustment
from bundle.interface.solve_record import Progress
from bundle.interface.summary import Summary
from bundle.model.problem import Problem
from bundle.solving.colmap_adjustment.adjusted_part import AdjustedPart, adjusted_part
from bundle.solving.colmap_adjustment.two_cameras import TwoCameras
from bundle.solving.solve import solve

if TYPE_CHECKING:
    from bundle.model.pycolmap.adjustment_objects import (
        BundleAdjustmentConfig,
        BundleAdjustmentOptions,
        BundleAdjustmentSummary,
        Reconstruction,
    )


def bundle_adjustment(
    reconstruction: Reconstruction,
    options: BundleAdjustmentOptions | None = None,
    config: BundleAdjustmentConfig | None = None,
    *,
    cancellation_token: Any = None,
    progress: Progress | None = None,
) -> BundleAdjustmentSummary:
    """Refine a pycolmap.Reconstruction in place, as ``pycolmap.bundle_adjustment`` does.

    A script changes one name::

        import bundle, pycolmap
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_principal_point = True
        summary = bundle.bundle_adjustment(reconstruction, options)

    The minimum is that of pycolmap: the same observations, constant variables, loss and options.
    Without ``config``, observations behind their camera are deleted first, all registered images
    are refined in the gauge of two cameras, and the errors of the points are updated, as in
    pycolmap. With ``config``, the function does what
    ``pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()`` does.

    Three differences remain. The gauge of two cameras fixes only the degrees of freedom that are
    free: with a metric rig, constant points or constant images, the cost is lower than pycolmap's,
    which fixes 7 in any case. The gauge of three points takes other points than pycolmap, and
    therefore reaches another cost. A solution that is invalid is discarded; the reconstruction
    then keeps its values, and ``termination_type`` is FAILURE.

    Args:
        reconstruction: the reconstruction to change.
        options: pycolmap's options; None: pycolmap's defaults.
        config: images and points to refine, and constant variables; None: all.
        cancellation_token: a ``pycolmap.CancellationToken``. Once it is cancelled, the solve stops
            after its current iteration.
        progress: function called after each iteration, as in :func:`bundle.solve`.

    Returns:
        pycolmap's CeresBundleAdjustmentSummary. Without observations,
        a BundleAdjustmentSummary, as in pycolmap.

    Raises:
        InputError: an option that bundle cannot honour, or an id that does not exist; the message
            names it. The reconstruction is unchanged.
    """
    require_pycolmap("bundle_adjustment")
    from bundle.model.pycolmap import (  # slow: load pycolmap
        adjustment_objects,
        changed_reconstruction,
    )
    from bundle.model.pycolmap.reconstruction import fields_of

    given, defaults, places = adjustment_objects.options_of(options)
    asked = colmap_adjustment(given, defaults, lambda name: places.get(name, name))
    if asked.asks_for_gpu:
        log("warning", "%s: bundle has no GPU solver; it uses the CPU", places["use_gpu"])
    selected = adjustment_objects.config_of(reconstruction, config)
    if config is None:
        changed_reconstruction.delete_observations_behind(reconstruction)
    whole = Problem(**fields_of(reconstruction))
    frames = changed_reconstruction.frames_of_images(reconstruction, whole.image_ids)
    part = adjusted_part(whole, frames, asked, selected)
    if part.problem.num_observations == 0:
        return adjustment_objects.empty_summary()
    limits = _Limits(progress, cancellation_token, asked.max_seconds)
    refined, summary = _refined(part, limits)
    changed_reconstruction.set_values(
        reconstruction,
        refined,
        images=part.named & ~part.constant_images,
        points=~part.constant_points,
    )
    if config is None:
        changed_reconstruction.update_errors(reconstruction)
    values = vars(summary) | limits.outcome(summary)
    result = adjustment_objects.summary_of(values)
    if asked.print_summary:
        print(f"Bundle adjustment report\n{result.brief_report()}", file=sys.stderr)
    return result


def _refined(part: AdjustedPart, limits: _Limits) -> tuple[Problem, Summary]:
    gauge = TwoCameras(part)
    result = solve(
        part.problem,
        part.options,
        constraints=part.constant_parts(gauge.held),
        progress=limits if limits.needed else None,
    )
    return gauge.rescaled(result.problem), result.summary


@dataclass
class _Limits:
    """Progress function that stops a solve when it is cancelled or takes too long."""

    progress: Progress | None
    token: Any
    max_seconds: float

    def __post_init__(self) -> None:
        self._started, self._is_late = time.monotonic(), False

    @property
    def needed(self) -> bool:
        """True if a solve has to call this function."""
        return self.progress is not None or self.token is not None or self.max_seconds < 1e9

    def __call__(self, iteration: dict[str, Any]) -> None:
        if self.progress is not None:
            self.progress(iteration)
        self._is_late = time.monotonic() - self._started >= self.max_seconds
        if self._is_late or (self.token is not None and self.token.is_cancelled):
            raise KeyboardInterrupt

    def outcome(self, summary: Summary) -> dict[str, str]:
        """Return the fields of Ceres' summary for a solve that was stopped."""
        if not summary.interrupted:
            return {}
        if self._is_late:
            return {
                "termination_type": "NO_CONVERGENCE",
                "message": f"Maximum solver time reached: {self.max_seconds} seconds.",
            }
        return {"termination_type": "USER_SUCCESS"}
