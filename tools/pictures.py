"""Write the pictures of docs/pictures.md, by the calls that stand there.

usage: python tools/pictures.py [FOLDER]    (default: docs)
"""

from __future__ import annotations

import sys
from pathlib import Path

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


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs"))
