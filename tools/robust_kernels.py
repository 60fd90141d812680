"""Write docs/robust_kernels.md: what robust losses do to a solver's steps, computed by bundle.

usage: python tools/robust_kernels.py > docs/robust_kernels.md
"""

from __future__ import annotations

from collections.abc import Iterable

from bundle.interface.options import LOSSES
from bundle.model.losses import correct, evaluate_loss, second_order_block

JACOBIAN = 2.0
RESIDUALS = (0.5, 1.0, 2.0, 3.0, 10.0)
WEIGHTS_AT = (0.5, 1.0, 2.0, 5.0)
FORMULAS = {
    "trivial": "s",
    "huber": "s up to a², then 2a√s - a²",
    "soft_l1": "2a² (√(1 + s/a²) - 1)",
    "cauchy": "a² log(1 + s/a²)",
    "arctan": "a² arctan(s/a²)",
    "tukey": "a²/3 (1 - (1 - s/a²)³) up to a², then a²/3",
}

PAGE = """\
<!-- Made by tools/robust_kernels.py; a test compares the two. -->
# Robust kernels

A residual r costs 1/2 rho(s), with s = ‖r‖². A least-squares solver works with residuals and
Jacobians only, so Ceres corrects both for the loss. `bundle.losses` computes every number below
with the code of a solve; [loss.h](../cpp/core/factors/loss.h) derives the formulas.

## The losses

{losses}

The weight rho' scales the influence of a residual on the solution. *Turns over* is the ‖r‖ beyond
which the cost is concave as a function of ‖r‖; without an entry the loss is convex. Ceres'
ArctanLoss compares s, not √s, with its scale. `bundle` passes a² to it, so that every loss has its
scale in pixels.

## The second-order block

The Gauss-Newton block of a residual is Jᵀ (rho' I + 2 rho'' r rᵀ) J: Triggs et al., *Bundle
Adjustment - A Modern Synthesis*, section 4.3. For a Cauchy kernel of scale 1 and J = {jacobian:g}:

{blocks}

Beyond ‖r‖ = {cauchy:.3f}, beyond the inflection point of the kernel, the block is not positive
definite. The quadratic model then has no minimum, and no corrected Jacobian J has J^T J equal to
this block. Triggs' correction exists only where the column *full correction* has numbers. Towards
the inflection point its Jacobian vanishes and its residual grows without bound.

Ceres omits the second-order term wherever rho'' <= 0, which holds everywhere for every loss of the
table. The remaining block is rho' JᵀJ, {clamped:+.3f} at r = {clamped_at:g}: never negative, and
with the same gradient. The price is linear convergence where the kernel bends strongly: the model
is stiffer than the cost, so steps are too short and reduce the cost by more than predicted. The
convergence check of `bundle` does not report this as a wrong Jacobian.
"""


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    header = list(header)
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def curvature(loss: str, scale: float, norm: float) -> float:
    """Return the second derivative of 1/2 rho(r^2) by r."""
    rho = evaluate_loss(loss, scale, [norm**2])[0]
    return float(second_order_block(rho, [norm], [[1.0]])[0, 0])


def turning_point(loss: str, scale: float) -> float | None:
    """Return the norm from which on the cost is concave, None for a convex loss."""
    below, above = 1e-3 * scale, 0.99 * scale
    if curvature(loss, scale, above) > 0:
        above = 1.01 * scale
    if curvature(loss, scale, above) >= 0:
        return None
    while above - below > 1e-12 * scale:
        middle = (below + above) / 2
        if curvature(loss, scale, middle) > 0:
            below = middle
        else:
            above = middle
    return below


def loss_rows() -> Iterable[list[str]]:
    """Yield a row a loss."""
    for loss in LOSSES:
        weights = evaluate_loss(loss, 1.0, [norm**2 for norm in WEIGHTS_AT])[:, 1]
        turn = turning_point(loss, 1.0)
        yield [
            f"`{loss}`",
            FORMULAS[loss],
            "-" if turn is None else f"{turn:.3f}",
            *(f"{weight:.4f}" for weight in weights),
        ]


def block_rows() -> Iterable[list[str]]:
    """Yield a row a residual, for a Cauchy kernel of scale 1."""
    for norm in RESIDUALS:
        rho = evaluate_loss("cauchy", 1.0, [norm**2])[0]
        block = second_order_block(rho, [norm], [[JACOBIAN]])[0, 0]
        full = correct(rho, [norm], [[JACOBIAN]], "full")
        yield [
            f"{norm:g}",
            f"{block:+.4f}" if abs(block) > 1e-12 else "0",
            "none" if full is None else f"{full.residual[0]:.4f}, {full.jacobian[0, 0]:.4f}",
            f"{clamped_block(norm):+.4f}",
        ]


def clamped_block(norm: float) -> float:
    """Return the square of the Jacobian that Ceres makes of J under a Cauchy kernel of scale 1."""
    rho = evaluate_loss("cauchy", 1.0, [norm**2])[0]
    corrected = correct(rho, [norm], [[JACOBIAN]], "ceres")
    assert corrected is not None
    return float(corrected.jacobian[0, 0] ** 2)


def page() -> str:
    """Return the page."""
    cauchy = turning_point("cauchy", 1.0)
    assert cauchy is not None
    return PAGE.format(
        losses=table(
            [
                "loss",
                "rho(s), scale a",
                "inflection, a = 1",
                *(f"rho' at {at:g} a" for at in WEIGHTS_AT),
            ],
            loss_rows(),
        ),
        blocks=table(
            ["r", "second-order block", "full correction: r, J", "block left by Ceres"],
            block_rows(),
        ),
        jacobian=JACOBIAN,
        cauchy=cauchy,
        clamped=clamped_block(3.0),
        clamped_at=3.0,
    )


if __name__ == "__main__":
    print(page(), end="")
