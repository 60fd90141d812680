"""Right Jacobians under stress, in the layouts of Ceres, GTSAM, manif and g2o.

Units of millimetres, coordinates of a map, tiny and unequal sigmas, rows in other units than the
others or with digits that cancel, robust losses at their kink,
angles close to pi, points close to the camera, variables at zero, and single precision.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from tests.campaigns.library_residuals import (
    RESIDUALS,
    Residual,
    angle_axis,
    between,
    in_library,
    of_ceres,
    reprojection,
)

LIBRARIES = ("ceres", "gtsam", "manif", "g2o", "g2o_expmap")


def wrapped(residual, change):
    """A residual with another function of the same values."""
    inner = residual.function
    return residual._replace(function=lambda values: change(*inner(values)))


def with_weights(residual, rng, low, high):
    """Rows divided by sigmas of different sizes."""
    size = len(residual.function(residual.values)[0])
    weights = np.linalg.qr(rng.standard_normal((size, size)))[0] * 10.0 ** rng.uniform(
        low, high, size
    )
    return wrapped(residual, lambda r, js: (weights.T @ r, [weights.T @ j for j in js]))


def with_loss(residual, loss, share):
    """sqrt(rho'(s)) r of a robust loss, with its exact derivative; `share` of the kink."""
    error = residual.function(residual.values)[0]
    kink = np.linalg.norm(error) / share

    def change(r, js):
        s = r @ r / kink**2
        if loss == "huber":
            root = 1.0 if s <= 1 else s**-0.25
            slope = 0.0 if s <= 1 else -0.25 * s**-1.25
        elif loss == "cauchy":
            root, slope = (1 + s) ** -0.5, -0.5 * (1 + s) ** -1.5
        else:  # tukey: (1 - s)^2 inside, 0 outside
            root, slope = (1 - s, -1.0) if s < 1 else (0.0, 0.0)
        turned = root * np.eye(len(r)) + slope * 2 / kink**2 * np.outer(r, r)
        return root * r, [turned @ j for j in js]

    return wrapped(residual, change)


def with_small_rows(residual, rng):
    """Rows in units of their own, down to 1e-12 of the others."""
    size = len(residual.function(residual.values)[0])
    units = 10.0 ** rng.uniform(-12, 0, size)
    return wrapped(residual, lambda r, js: (units * r, [units[:, None] * j for j in js]))


def with_constants(residual, rng):
    """Small rows with large constants, whose last digits are lost."""
    small = with_small_rows(residual, rng)
    size = len(residual.function(residual.values)[0])
    constants = 10.0 ** rng.uniform(-6, 6, size)
    return wrapped(small, lambda r, js: ((r + constants) - constants, js))


def with_cancelling_rows(residual, rng):
    """Rows that are small because large numbers cancel in them."""
    size = len(residual.function(residual.values)[0])
    turn = np.linalg.qr(rng.standard_normal((size, size)))[0]
    small = turn * 10.0 ** rng.uniform(-9, 0, size)
    there = small @ np.linalg.qr(rng.standard_normal((size, size)))[0]
    return wrapped(
        residual, lambda r, js: (turn.T @ (there @ r), [turn.T @ (there @ j) for j in js])
    )


def minus_measured(residual, rng, size):
    """The difference to a measurement close to it: digits cancel."""
    measured = residual.function(residual.values)[0] + size * rng.standard_normal(
        len(residual.function(residual.values)[0])
    )
    return wrapped(residual, lambda r, js: (r - measured, js))


def in_single(residual, with_jacobians):
    """Residuals computed in single precision, the Jacobians in single or in double precision."""

    def change(r, js):
        js = [j.astype(np.float32) for j in js] if with_jacobians else js
        return r.astype(np.float32), js

    return wrapped(residual, change)


def at_zero(residual):
    """Translations, or a rotation vector, at zero."""
    values = [value.copy() for value in residual.values]
    for value, manifold in zip(values, residual.manifolds, strict=True):
        if manifold == "se3":
            value[4:] = 0
        elif manifold == "se2":
            value[:] = 0
    return residual._replace(values=values)


STRESSES = {
    "plain": lambda make, rng: make(rng),
    "millimetres": lambda make, rng: make(rng, scale=1e3),
    "micrometres": lambda make, rng: make(rng, scale=1e6),
    "kilometres": lambda make, rng: make(rng, scale=1e-3),
    "map": lambda make, rng: make(rng, scale=10.0, offset=rng.uniform(3e5, 5e5)),
    "small sigmas": lambda make, rng: with_weights(make(rng), rng, 3, 6),
    "unequal sigmas": lambda make, rng: with_weights(make(rng), rng, -4, 4),
    "large sigmas": lambda make, rng: with_weights(make(rng), rng, -8, -6),
    "small rows": lambda make, rng: with_small_rows(make(rng), rng),
    "small rows with constants": lambda make, rng: with_constants(make(rng), rng),
    "cancelling rows": lambda make, rng: with_cancelling_rows(make(rng), rng),
    "measured": lambda make, rng: minus_measured(make(rng), rng, 1e-6),
    "huber at the kink": lambda make, rng: with_loss(make(rng), "huber", 1.0),
    "huber near the kink": lambda make, rng: with_loss(make(rng), "huber", 1.001),
    "huber": lambda make, rng: with_loss(make(rng), "huber", rng.uniform(0.5, 3)),
    "cauchy": lambda make, rng: with_loss(make(rng), "cauchy", rng.uniform(0.1, 10)),
    "tukey near the kink": lambda make, rng: with_loss(make(rng), "tukey", 0.999),
    "tukey outside": lambda make, rng: with_loss(make(rng), "tukey", 1.2),
    "single": lambda make, rng: in_single(make(rng), with_jacobians=True),
    "single residual": lambda make, rng: in_single(make(rng), with_jacobians=False),
    "at zero": lambda make, rng: at_zero(make(rng)),
}

SPECIAL = {
    "near pi": lambda rng: between(rng, angle=np.pi - 10.0 ** rng.uniform(-6, -2)),
    "no error": lambda rng: between(rng, angle=10.0 ** rng.uniform(-9, -6)),
    "near the camera": lambda rng: reprojection(rng, depth=10.0 ** rng.uniform(-6, -2)),
    "far from the camera": lambda rng: reprojection(rng, depth=10.0 ** rng.uniform(3, 6)),
}


def draw(rng) -> tuple[str, str, Residual]:
    """Return a library, a name and a right residual."""
    library = str(rng.choice(LIBRARIES))
    if library == "ceres":
        makers = {
            "w x y z": of_ceres,
            "x y z w": partial(of_ceres, order="xyzw"),
            "angle axis": angle_axis,
        }
    else:
        makers = dict(RESIDUALS)
    if library != "ceres" and rng.random() < 0.2:
        name = str(rng.choice(list(SPECIAL)))
        return library, name, in_library(SPECIAL[name](rng), library)
    stress, kind = str(rng.choice(list(STRESSES))), str(rng.choice(list(makers)))

    def make(rng, **scales):
        made = makers[kind](rng, **scales)
        return made if library == "ceres" else in_library(made, library)

    return library, f"{kind}, {stress}", STRESSES[stress](make, rng)
