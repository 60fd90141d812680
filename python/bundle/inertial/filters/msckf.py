"""Update of a multi-state constraint Kalman filter (MSCKF) by tracks without landmark states.

Mourikis and Roumeliotis, "A Multi-State Constraint Kalman Filter for Vision-aided Inertial
Navigation", ICRA 2007. A track's innovation is r = H d + F f + n with the error d of the state, the
error f of the landmark, and white noise n of variance 1. The orthonormal columns of N, with N^T F =
0, span the left null space of F:

    N^T r = (N^T H) d + N^T n,

with 2 M - 3 rows for M views; N^T n is white like n. This eliminates the landmark exactly as a
Schur complement does: with the projection N N^T = I - F (F^T F)^-1 F^T,

    (N^T H)^T (N^T H) = H^T H - H^T F (F^T F)^-1 F^T H.

The rows of all tracks together outnumber the coordinates of the state. A QR factorisation A = Q T
compresses them: T replaces A, and Q^T r the innovation. The update is Kalman's in Joseph's form,
with S = T P T^T + I and K = P T^T S^-1:

    d = K r,        P <- (I - K T) P (I - K T)^T + K K^T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arguments import as_array, check_type
from bundle.base.display import Display, Displayed
from bundle.errors import InputError
from bundle.inertial.filters.track_linearization import TrackRows
from bundle.interface.option_fields import number

__all__ = ["MsckfUpdate", "msckf_update"]

Array = NDArray[np.float64]

_NO_PARALLAX = 1e-7  # smallest singular value of F with columns scaled to 1


@dataclass(frozen=True, eq=False, repr=False)
class MsckfUpdate(Displayed):
    """Update of a state by tracks.

    Attributes:
        step: (n,) step of the state's tangent coordinates.
        covariance: (n, n) after the update.
        rejected: position of each left-out track, and the reason.
        nis: (number of tracks,) normalised innovation squared per row of the null space; about 1
            for a healthy track, nan without a null space.
        num_rows: rows of all used tracks, without their landmarks.
        num_compressed_rows: rows after the compression.
    """

    step: Array
    covariance: Array
    rejected: tuple[tuple[int, str], ...]
    nis: Array
    num_rows: int
    num_compressed_rows: int

    def _display(self) -> Display:
        used = len(self.nis) - len(self.rejected)
        return Display(
            title=f"MsckfUpdate: {used} of {len(self.nis)} tracks",
            facts=(
                ("rows", f"{self.num_rows}, compressed to {self.num_compressed_rows}"),
                *((f"track {place}", why) for place, why in self.rejected),
            ),
        )


def msckf_update(
    covariance: ArrayLike, tracks: Sequence[TrackRows], *, max_nis: float | None = None
) -> MsckfUpdate:
    """Return the update of a state by tracks, with their landmarks projected out.

    Args:
        covariance: (n, n) in the state's tangent coordinates, symmetric positive semidefinite.
        tracks: tracks from :func:`bundle.track_rows`, at one estimate.
        max_nis: tracks with a larger NIS per row are left out; None: no limit. 2 leaves out 3 % of
            healthy tracks of 6 views.

    Raises:
        InputError: shapes do not fit, or numbers are not finite.
    """
    before = as_array("covariance", covariance)
    size = len(before) if before.ndim else 0
    if before.shape != (size, size) or not size or not np.isfinite(before).all():
        raise InputError(f"covariance: expected finite numbers (n, n), found shape {before.shape}")
    scale = np.abs(before).max()
    if np.abs(before - before.T).max() > 1e-9 * scale:
        raise InputError("covariance: expected a symmetric matrix, found an asymmetric one")
    limit = np.inf if max_nis is None else number("max_nis", max_nis, above=0)
    rejected, nis, rows, innovations = [], np.full(len(tracks), np.nan), [], []
    for place, track in enumerate(tracks):
        check_type(f"tracks[{place}]", track, TrackRows)
        if track.by_state.shape[1] != size:
            raise InputError(
                f"tracks[{place}]: expected {size} coordinates, as in the covariance, found "
                f"{track.by_state.shape[1]}"
            )
        null_space = _left_null_space(track.by_point)
        if null_space is None:
            rejected.append((place, "no parallax: the views do not determine a landmark"))
            continue
        by_state, innovation = null_space.T @ track.by_state, null_space.T @ track.innovation
        spread = by_state @ before @ by_state.T + np.eye(len(by_state))
        nis[place] = innovation @ np.linalg.solve(spread, innovation) / len(innovation)
        if nis[place] > limit:
            rejected.append((place, f"NIS {nis[place]:.3g} per row, above {limit:g}"))
            continue
        rows.append(by_state)
        innovations.append(innovation)
    if not rows:
        nothing = before.copy()
        return MsckfUpdate(np.zeros(size), nothing, tuple(rejected), nis, 0, 0)
    stacked, right = np.vstack(rows), np.concatenate(innovations)
    compressed = stacked
    if len(stacked) > size:
        q, compressed = np.linalg.qr(stacked)
        right = q.T @ right
    gain = np.linalg.solve(
        compressed @ before @ compressed.T + np.eye(len(compressed)), compressed @ before
    ).T
    keep = np.eye(size) - gain @ compressed
    after = keep @ before @ keep.T + gain @ gain.T
    return MsckfUpdate(
        step=gain @ right,
        covariance=(after + after.T) / 2,
        rejected=tuple(rejected),
        nis=nis,
        num_rows=len(stacked),
        num_compressed_rows=len(compressed),
    )


def _left_null_space(by_point: Array) -> Array | None:
    """Return N (m, m - 3), or None if the views determine fewer than 3 landmark directions."""
    if len(by_point) < 4:
        return None
    scaled = by_point / np.maximum(np.linalg.norm(by_point, axis=0), np.finfo(float).tiny)
    if np.linalg.svd(scaled, compute_uv=False)[-1] < _NO_PARALLAX:
        return None
    q, _ = np.linalg.qr(by_point, mode="complete")
    return q[:, 3:]
