"""Outcome of each rule in a solve."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BoundEnd", "PriorEnd", "RuleEnd", "TieEnd"]


@dataclass(frozen=True, kw_only=True)
class PriorEnd:
    """Distance of a solved parameter from its prior.

    Attributes:
        subject: "camera", "image" or "point".
        id: of it.
        parameter: its name, such as "fx", "position" or "rotation".
        known: as it was known: a number, or x, y, z; of a rotation qx, qy, qz, qw.
        sigma: in the parameter's unit, degrees for a rotation, per axis for a position; where
            relative a share of the value.
        relative: whether the logarithm was known.
        before: at the start, as known.
        after: at the end, as known.
        pull: how far the end is from what was known, in sigmas: with its sign for a number, the
            length otherwise. The prior costs half its square.
    """

    subject: str
    id: int
    parameter: str
    known: tuple[float, ...]
    sigma: tuple[float, ...]
    relative: bool
    before: tuple[float, ...]
    after: tuple[float, ...]
    pull: float


@dataclass(frozen=True, kw_only=True)
class BoundEnd:
    """A bound on which a parameter ends.

    Attributes:
        camera_id: of the camera.
        parameter: its name.
        side: "lower" or "upper".
        value: the bound.
    """

    camera_id: int
    parameter: str
    side: str
    value: float


@dataclass(frozen=True, kw_only=True)
class TieEnd:
    """Parameters that moved as one number.

    Attributes:
        camera_ids: of the cameras, one entry a parameter.
        parameters: their names.
        multiples: how many times the number each is.
        before: each at the input, before they were made equal.
        after: each at the end.
    """

    camera_ids: tuple[int, ...]
    parameters: tuple[str, ...]
    multiples: tuple[float, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class RuleEnd:
    """One rule and what became of it.

    Attributes:
        rule: its text.
        place: where it was given.
        kind: "fixed", "prior", "bounds", "share" or "ratio".
        num_parameters: how many parameters, positions and rotations it is about.
        priors: of a prior.
        active_bounds: of bounds: those on which parameters end.
        ties: of a share or ratio: what moved together, with what other rules tie to it.
    """

    rule: str
    place: str
    kind: str
    num_parameters: int
    priors: tuple[PriorEnd, ...] = ()
    active_bounds: tuple[BoundEnd, ...] = ()
    ties: tuple[TieEnd, ...] = ()
