"""Spectrum of the information matrix of a prior, as an indicator of its numerical health."""

from __future__ import annotations

import numpy as np

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.graphs.factors.variables import Array

ASYMMETRY_LIMIT = 1e-9
CONDITION_LIMIT = 1e8


@dataclass(frozen=True, repr=False)
class PriorSpectrum(Displayed):
    """Eigenvalues of the information matrix of a prior, in the units of its coordinates.

    A healthy prior of a sliding window keeps its ratio above 1e-6 without a trend. In single
    precision, the ratio falls over some hundred windows until the smallest eigenvalue is negative.

    Attributes:
        min_eigenvalue: smallest eigenvalue; rounding error if the prior has a null space.
        max_eigenvalue: largest eigenvalue.
        nullity: dimension of the null space: number of eigenvalues that are rounding errors after
            the diagonal is scaled to 1.
        ratio: smallest eigenvalue outside the null space relative to the largest.
        asymmetry: largest difference of two symmetric entries relative to the largest entry.
    """

    min_eigenvalue: float
    max_eigenvalue: float
    nullity: int
    ratio: float
    asymmetry: float

    @staticmethod
    def of(matrix: Array) -> PriorSpectrum:
        """Return the spectrum of a square matrix of finite numbers in its own precision."""
        n = len(matrix)
        largest_entry = float(np.abs(matrix).max(initial=0.0))
        difference = float(np.abs(matrix - matrix.T).max(initial=0.0))
        rounding = 16 * n * float(np.finfo(matrix.dtype).eps)
        symmetric = (matrix.astype(np.float64) + matrix.astype(np.float64).T) / 2
        eigenvalues = np.linalg.eigvalsh(symmetric)
        diagonal = np.diag(symmetric)
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        scaled = np.linalg.eigvalsh(scale[:, None] * symmetric * scale)
        nullity = int((np.abs(scaled) <= rounding * np.abs(scaled).max(initial=0.0)).sum())
        largest = float(eigenvalues[-1]) if n else 0.0
        # The null space has the eigenvalues nearest to 0.
        others = np.sort(eigenvalues[np.argsort(np.abs(eigenvalues), kind="stable")[nullity:]])
        return PriorSpectrum(
            float(eigenvalues[0]) if n else 0.0,
            largest,
            nullity,
            float(others[0]) / largest if len(others) and largest else 0.0,
            difference / largest_entry if largest_entry else 0.0,
        )

    @staticmethod
    def of_root(root: Array) -> PriorSpectrum:
        """Return the spectrum of R^T R from the singular values of R, with twice the digits."""
        rows, n = root.shape
        padded = np.vstack((root, np.zeros((max(n - rows, 0), n))))
        norms = np.linalg.norm(padded, axis=0)
        scaled = np.linalg.svd(padded / np.where(norms > 0, norms, 1.0), compute_uv=False)
        rounding = 16 * n * float(np.finfo(root.dtype).eps)
        nullity = int((scaled <= rounding * scaled[0]).sum())
        values = np.linalg.svd(padded, compute_uv=False) ** 2
        least = float(values[n - nullity - 1]) if nullity < n else 0.0
        largest = float(values[0])
        return PriorSpectrum(
            float(values[-1]), largest, nullity, least / largest if largest else 0.0, 0.0
        )

    @property
    def warning(self) -> str:
        """Warning if the prior should not be trusted, otherwise ""."""
        if self.asymmetry > ASYMMETRY_LIMIT:
            return f"asymmetry {self.asymmetry:.1e} is above {ASYMMETRY_LIMIT:g}"
        if self.ratio < 0:
            return f"the smallest eigenvalue is negative, {self.min_eigenvalue:.3g}"
        if self.ratio < 1 / CONDITION_LIMIT:
            return f"condition {1 / self.ratio if self.ratio else np.inf:.1e} is above " + (
                f"{CONDITION_LIMIT:g}"
            )
        return ""

    def line(self) -> str:
        """Return all values in one line."""
        free = f", {self.nullity} free" if self.nullity else ""
        return (
            f"{self.min_eigenvalue:.3g} to {self.max_eigenvalue:.3g}, "
            f"ratio {self.ratio:.1e}{free}, asymmetry {self.asymmetry:.1e}"
        )

    def _display(self) -> Display:
        facts = [
            ("eigenvalues", f"{self.min_eigenvalue:.6g} to {self.max_eigenvalue:.6g}"),
            ("free directions", str(self.nullity)),
            ("ratio", f"{self.ratio:.3g}"),
            ("asymmetry", f"{self.asymmetry:.3g}"),
        ]
        if self.warning:
            facts.append(("warning", self.warning))
        return Display(title="PriorSpectrum", facts=tuple(facts))
