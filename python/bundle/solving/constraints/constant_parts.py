"""Constant parameters and pose parts of a problem under rules, with the reason for each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set

from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.solving.constraints.rules import Rule
from bundle.solving.constraints.ties import Member


class ConstantParts:
    """Parameters, poses and points that rules, options or the subset of a solve make constant.

    Args:
        rules: the rules as the caller gave them.
        problem: the problem with the cameras, images and points that the rules name.
        options: options; their fixed ids and ``refine`` make parameters constant, too.
        part: ids of the refined cameras, images and points; None: all.
    """

    def __init__(
        self,
        rules: tuple[Rule, ...],
        problem: Problem,
        options: SolveOptions,
        part: Mapping[str, Set[int]] | None,
    ) -> None:
        self._rules, self._problem, self._options, self._part = rules, problem, options, part
        self._params = problem.camera_params.copy()
        self._fixed: dict[Member, int] = {}  # rule that makes a parameter constant
        self._bounds: dict[Member, tuple[float, float]] = {}
        self._bounded: dict[Member, int] = {}
        self._poses: dict[tuple[int, str], int] = {}  # rule that fixes part of a pose
        self._points: dict[int, int] = {}
        self._free_kinds = set(options.refine)
        self._fixed_ids = {
            kind: set(getattr(options, f"fixed_{kind}_ids"))
            for kind in ("camera", "image", "point")
        }

    def _check_bounds(self) -> None:
        for member, (lower, upper) in self._bounds.items():
            value = self._params[member]
            if not lower <= value <= upper:
                raise InputError(
                    f"{self._place(self._bounded[member])}: {self._name(member)}: expected a start "
                    f"within [{lower:g}, {upper:g}], found {value:.10g}"
                )

    def _is_on_rig(self, image: int) -> bool:
        frames = self._problem.image_frame
        return len(frames) > 0 and bool(frames[image] >= 0)

    def _why_held(self, member: Member) -> str:
        """Return why a parameter is constant; "" if it is not constant."""
        if member in self._fixed:
            return f"is held by {self._place(self._fixed[member])}"
        camera, j = member
        key = int(self._problem.camera_ids[camera])
        if self._is_outside("camera", key):
            return "is held (its camera took none of the images that are refined)"
        if key in self._fixed_ids["camera"]:
            return f"is held (camera {key} is among the fixed ones)"
        kind = param_kinds(self._problem.camera_models[camera])[j]
        if kind == "metadata":
            return "no solve refines"
        if kind not in self._free_kinds:
            return f"is held (refine lacks {kind})"
        lower, upper = self._bounds.get(member, (-math.inf, math.inf))
        return f"is held by {self._place(self._bounded[member])}" if lower == upper else ""

    def _why_pose_held(self, kind: str, index: int, name: str) -> str:
        key = int(getattr(self._problem, f"{kind}_ids")[index])
        group = "points" if kind == "point" else "poses"
        rule = self._points.get(index) if kind == "point" else self._poses.get((index, name))
        if rule is not None:
            return f"is held by {self._place(rule)}"
        if key in self._fixed_ids[kind]:
            return f"is held (it is among the fixed {kind}s)"
        return "" if group in self._free_kinds else f"is held (refine lacks {group})"

    def _is_outside(self, kind: str, key: int) -> bool:
        return self._part is not None and key not in self._part[kind]

    def _place(self, number: int) -> str:
        return self._rules[number].place

    def _name(self, member: Member) -> str:
        camera, j = member
        name = camera_models()[self._problem.camera_models[camera]][j]
        return f"{name} of camera {self._problem.camera_ids[camera]}"
