"""Write the README's picture: the model in data/ from above and its residuals, before and after.

usage: python tools/readme_picture.py [FILE]    (default: docs/before_after.png)
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle
from bundle import pictures
from bundle.model.residuals import linearize, reprojection_errors

ROOT = Path(__file__).resolve().parent.parent
MODEL = ROOT / "data" / "street_colmap"
SHOWN_PIXELS = 40.0  # half the width of the plots of residuals
COLOUR_LIMITS = (0.3, 100.0)  # pixels, on a log scale


def median_errors(problem: bundle.Problem) -> NDArray[np.float64]:
    """Return the median reprojection error per point, in pixels."""
    errors, _ = reprojection_errors(problem)
    order = np.lexsort((errors, problem.observation_point))
    lengths = np.bincount(problem.observation_point, minlength=problem.num_points)
    ends = np.cumsum(lengths)
    medians: NDArray[np.float64] = errors[order][ends - 1 - lengths // 2]
    return medians


def draw_from_above(axis: Any, problem: bundle.Problem, title: str) -> Any:
    """Draw points in the colour of their error, and cameras; return the coloured points."""
    centers = problem.projection_centers
    flat = np.argsort(np.ptp(centers, axis=0))[1:]  # the two axes along which the cameras spread
    first, second = sorted(flat)
    axis.plot(centers[:, first], centers[:, second], "-", color="0.6", linewidth=0.7, zorder=1)
    axis.plot(centers[:, first], centers[:, second], "k^", markersize=4.5, zorder=3)
    points = axis.scatter(
        problem.points[:, first],
        problem.points[:, second],
        c=np.clip(median_errors(problem), *COLOUR_LIMITS),
        s=3,
        cmap="turbo",
        norm="log",
        vmin=COLOUR_LIMITS[0],
        vmax=COLOUR_LIMITS[1],
        zorder=2,
    )
    # A point without parallax may be anywhere: the view is of 96 % of the points and the cameras.
    shown = np.concatenate([centers, problem.points])[:, [first, second]]
    low, high = np.quantile(shown, [0.02, 0.98], axis=0)
    margin = 0.15 * (high - low).max()
    axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axis.set(title=title, aspect="equal", xlabel="m", ylabel="m")
    return points


def draw_residuals(axis: Any, problem: bundle.Problem) -> None:
    """Draw every residual, projection minus measurement, as a dot in the plane."""
    residuals = linearize(problem).residual
    axis.plot(*residuals.T, ".", color="#0f6fb4", markersize=1.6, markeredgewidth=0)
    axis.axhline(0, color="0.7", linewidth=0.6)
    axis.axvline(0, color="0.7", linewidth=0.6)
    limits = (-SHOWN_PIXELS, SHOWN_PIXELS)
    median = np.median(np.linalg.norm(residuals, axis=1))
    axis.set(
        xlim=limits,
        ylim=limits,
        aspect="equal",
        title=f"residuals, median {median:.2f} px",
        xlabel="px",
        ylabel="px",
    )


def main(path: Path) -> None:
    """Refine the model and draw both states."""
    problem = bundle.load(MODEL)
    result = bundle.solve(problem, loss="cauchy")
    seconds = result.summary.total_time_in_seconds
    made, axes = pictures.figure(1, 4, width=3.1, height=3.2)
    draw_from_above(axes[0, 0], problem, "before")
    draw_residuals(axes[0, 1], problem)
    points = draw_from_above(
        axes[0, 2], result.problem, f"after {len(result.iterations['cost']) - 1} steps"
    )
    draw_residuals(axes[0, 3], result.problem)
    made.colorbar(points, ax=axes[0, :], label="median error per point [px]", shrink=0.8)
    made.savefig(path, dpi=110)
    print(f"{path}: {seconds:.3f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "before_after.png")
