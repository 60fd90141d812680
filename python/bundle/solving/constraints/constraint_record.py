"""Outcome of each rule in a solve."""

from __future__ import annotations

from bundle.base.records import dataclass


@dataclass(frozen=True, kw_only=True)
class PriorEnd:
    """Distance of a solved parameter from its prior.

    Attributes:
        subject: "camera", "image" or "point".
        id: id of the camera, image or point.
        parameter: name of the parameter, such as "fx", "position" or "rotation".
        known: prior value: a number; x, y, z of a position; or qx, qy, qz, qw of a rotation.
        sigma: standard deviation in the parameter's unit; degrees for a rotation; per axis for a
            position; a fraction of the value if `relative`.
        relative: True if the prior is on the logarithm.
        before: value at the start, in the form of `known`.
        after: value at the end, in the form of `known`.
        pull: difference of the end from the prior value, in sigmas: signed for a number, the
            length of the vector otherwise. The cost of the prior is half the square of the pull.
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
    """A bound that a parameter reaches at the end of a solve.

    Attributes:
        camera_id: id of the camera.
        parameter: name of the parameter.
        side: "lower" or "upper".
        value: the bound.
    """

    camera_id: int
    parameter: str
    side: str
    value: float


@dataclass(frozen=True, kw_only=True)
class TieEnd:
    """Parameters that the solver moved as multiples of one number.

    Attributes:
        camera_ids: id of the camera of each parameter.
        parameters: name of each parameter.
        multiples: ratio of each parameter to the shared number.
        before: value of each parameter in the input, before the solver made them equal.
        after: value of each parameter at the end.
    """

    camera_ids: tuple[int, ...]
    parameters: tuple[str, ...]
    multiples: tuple[float, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class RuleEnd:
    """One rule and its outcome.

    Attributes:
        rule: text of the rule.
        place: place of the rule in a file or list.
        kind: "fixed", "prior", "bounds", "share" or "ratio".
        num_parameters: number of parameters, positions and rotations that the rule names.
        priors: outcome of each prior, for a rule of kind "prior".
        active_bounds: bounds that parameters reach at the end, for a rule of kind "bounds".
        ties: groups of parameters that moved together, for a share or ratio; a group includes
            parameters that other rules tie to it.
    """

    rule: str
    place: str
    kind: str
    num_parameters: int
    priors: tuple[PriorEnd, ...] = ()
    active_bounds: tuple[BoundEnd, ...] = ()
    ties: tuple[TieEnd, ...] = ()
