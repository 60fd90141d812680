"""Textbook estimate of bundle adjustment with and without eliminating the points first.

This is the estimate of lectures and papers, for n_c cameras of 6 unknowns, n_p points of 3 unknowns
and a dense S. It gives orders of magnitude, not instructions. A product of m x k and k x n matrices
counts m k n, the inverse of a 3 x 3 block 3^3, a Cholesky factorisation of n columns n^3 / 3.

    points    V_p^-1 for each point: 27 n_p
    products  W_ip V_p^-1 W_jp^T for each point p and each ordered pair of cameras (i, j) that see
              it, also for i = j: 162 = 6 3 3 + 6 3 6 per product. A point that d cameras see has
              d^2 products; they share no factors
    reduced   Cholesky of S: (6 n_c)^3 / 3
    dense     Cholesky of all 6 n_c + 3 n_p unknowns at once, for comparison

``inspect`` counts the work of solvers: the pattern of S, an elimination order, one triangle.
"""

from __future__ import annotations

from bundle.base.records import dataclass

CAMERA_SIZE, POINT_SIZE = 6, 3


@dataclass(frozen=True)
class SchurCounts:
    """Textbook flops of one linear solve.

    Attributes:
        num_unknowns: unknowns of cameras and points.
        num_reduced_unknowns: rows and columns of S.
        num_block_products: products W V^-1 W^T, one per ordered pair of cameras and point.
        points: flops of inverting the points' blocks.
        products: flops of the block products.
        reduced: flops of factorising S.
        dense: flops of factorising the dense matrix of all unknowns.
    """

    num_unknowns: int
    num_reduced_unknowns: int
    num_block_products: int
    points: float
    products: float
    reduced: float
    dense: float

    @property
    def schur(self) -> float:
        """Flops with the points eliminated first."""
        return self.points + self.products + self.reduced


def count_schur(num_cameras: int, num_points: int, track_length: int) -> SchurCounts:
    """Count flops for points that are seen by the same number of cameras each."""
    num_reduced = CAMERA_SIZE * num_cameras
    num_unknowns = num_reduced + POINT_SIZE * num_points
    num_products = track_length**2 * num_points
    product = CAMERA_SIZE * POINT_SIZE**2 + CAMERA_SIZE**2 * POINT_SIZE
    return SchurCounts(
        num_unknowns=num_unknowns,
        num_reduced_unknowns=num_reduced,
        num_block_products=num_products,
        points=float(POINT_SIZE**3 * num_points),
        products=float(product * num_products),
        reduced=num_reduced**3 / 3,
        dense=num_unknowns**3 / 3,
    )
