"""Write the pictures of docs/pictures.md, by its calls, and of docs/rolling_shutter.md.

usage: python tools/pictures.py [FOLDER]    (default: docs)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import bundle
from bundle import pictures

ORDERINGS = ("natural", "amd", "metis")


def main(folder: Path) -> None:
    """Draw a street of 1,000 images: its S and L under three orders, and its co-visibility."""
    scene = bundle.synthesize(scene="street", num_images=1000, num_points=50_000, seed=0)
    reduced = pictures.reduced_pattern(scene.problem)
    orders = pictures.draw_orderings(reduced, ORDERINGS)
    orders.savefig(folder / "orderings.png", dpi=90)
    made, axes = pictures.figure(1, 2, width=4.4, height=4.4)
    pictures.draw_covisibility(axes[0, 0], scene.problem)
    arrowhead = pictures.information_pattern(scene.problem)
    pictures.spy(axes[0, 1], arrowhead, title="information matrix, points first")
    made.savefig(folder / "covisibility.png", dpi=90)
    rolling_shutter(folder)


def rolling_shutter(folder: Path) -> None:
    """Draw a film of a phone, solved with a global and with a rolling shutter."""
    scene = bundle.synthesize(
        scene="orbit", num_images=30, num_points=900, rolling_shutter=0.8, seed=4
    )
    still = bundle.solve(scene.problem.replace(rolling_shutter=None)).problem
    moving = bundle.solve(scene.problem).problem
    made, axes = pictures.figure(1, 2, width=4.6, height=4.6)
    found = [
        bundle.figures.row_residuals(one, bundle.figures.residuals(one)) for one in (still, moving)
    ]
    pictures.draw_row_residuals(axes[0, 0], *[rows for rows in found if rows is not None])
    lines = []
    for name, one, dash in (("global shutter", still, 1), ("rolling shutter", moving, 0)):
        compared = bundle.evaluate(one, scene.ground_truth)
        assert isinstance(compared, bundle.Evaluation)
        errors = [image.position for image in compared.images]
        images = np.arange(1.0, len(errors) + 1)
        lines.append(bundle.figures.Line(name, images, 1000 * np.array(errors), dash=dash))
    errors_of_positions = bundle.figures.line_figure(
        name="positions",
        title="Errors of positions",
        x_label="image",
        y_label="error [mm]",
        lines=tuple(lines),
    )
    pictures.draw_lines(axes[0, 1], errors_of_positions)
    made.savefig(folder / "rolling_shutter.png", dpi=90)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs"))
