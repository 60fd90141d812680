"""Constant and tied parameters of a problem under rules."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Set

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.solving.constraints.rules import Rule


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
            return f"is constant by {self._place(self._fixed[member])}"
        camera, j = member
        key = int(self._problem.camera_ids[camera])
        if self._is_outside("camera", key):
            return "is constant (its camera took none of the refined images)"
        if key in self._fixed_ids["camera"]:
            return f"is constant (camera {key} is a fixed camera)"
        kind = param_kinds(self._problem.camera_models[camera])[j]
        if kind == "metadata":
            return "no solve refines"
        if kind not in self._free_kinds:
            return f"is constant (refine lacks {kind})"
        lower, upper = self._bounds.get(member, (-math.inf, math.inf))
        return f"is constant by {self._place(self._bounded[member])}" if lower == upper else ""

    def _why_pose_held(self, kind: str, index: int, name: str) -> str:
        key = int(getattr(self._problem, f"{kind}_ids")[index])
        group = "points" if kind == "point" else "poses"
        rule = self._points.get(index) if kind == "point" else self._poses.get((index, name))
        if rule is not None:
            return f"is constant by {self._place(rule)}"
        if key in self._fixed_ids[kind]:
            return f"is constant (it is one of the fixed {kind}s)"
        return "" if group in self._free_kinds else f"is constant (refine lacks {group})"

    def _is_outside(self, kind: str, key: int) -> bool:
        return self._part is not None and key not in self._part[kind]

    def _place(self, number: int) -> str:
        return self._rules[number].place

    def _name(self, member: Member) -> str:
        camera, j = member
        name = camera_models()[self._problem.camera_models[camera]][j]
        return f"{name} of camera {self._problem.camera_ids[camera]}"


# Tied parameters: each is a multiple of one shared number.
#
# ``share`` makes parameters of several cameras equal. A ratio makes one parameter of a camera a
# multiple of another. Together they make groups. The members of a group are x_i = s_i u with one
# number u, so that the ratios x_i / x_j = s_i / s_j hold by construction. The solver has one
# unknown per group: Jacobian columns are eliminated, no penalty is added.
#
# At the start, u is the unweighted mean of x_i / s_i. If a member is constant, u is the value of
# that member, and the entire group is constant. If the members already agree except for rounding, u
# is the value of the first member.

Member = tuple[int, int]
"""Index of a camera and column of a parameter."""

ROUNDING = 1e-12
MOST_SHARED = 16
"""Largest number of shared values of cameras that are tied, directly or through others."""


@dataclass(frozen=True)
class Group:
    """Tied parameters with their multiples, and the rules that tie them, in order."""

    members: tuple[tuple[Member, float], ...]
    rules: tuple[int, ...]

    def start(
        self,
        value: Callable[[Member], float],
        held: Callable[[Member], bool],
        describe: Callable[[Member], str],
    ) -> tuple[float, bool]:
        """Return u, and True if a constant member makes u constant.

        Args:
            value: function that returns the start value of a member.
            held: function that returns True if a member is constant.
            describe: function that returns the description of a member for messages.
        """
        said = [(member, value(member) / times) for member, times in self.members]
        fixed = [(member, u) for member, u in said if held(member)]
        if fixed:
            (first, u), *others = fixed
            for other, found in others:
                if not _agree(u, found):
                    raise InputError(
                        "expected equal values of tied constant parameters, found "
                        f"{describe(first)} at {value(first):.10g} and {describe(other)} at "
                        f"{value(other):.10g}"
                    )
            return u, True
        u = said[0][1]
        if all(_agree(u, found) for _, found in said):
            return u, False
        return sum(found for _, found in said) / len(said), False


def check_components(groups: Iterable[Group]) -> Group | None:
    """Return a group of a component that has more than MOST_SHARED shared numbers, or None.

    The core has one block for all shared numbers of connected cameras.
    """
    parent: dict[int, int] = {}

    def root(camera: int) -> int:
        while parent.setdefault(camera, camera) != camera:
            camera = parent[camera]
        return camera

    of_several = [group for group in groups if group.members[0][0][0] != group.members[-1][0][0]]
    for group in of_several:
        for (camera, _), _ in group.members:
            parent[root(camera)] = root(group.members[0][0][0])
    sizes: dict[int, int] = {}
    for group in of_several:
        at = root(group.members[0][0][0])
        sizes[at] = sizes.get(at, 0) + 1
        if sizes[at] > MOST_SHARED:
            return group
    return None


def _agree(a: float, b: float) -> bool:
    return abs(a - b) <= ROUNDING * max(abs(a), abs(b))


def divided_bounds(bounds: tuple[float, float], times: float) -> tuple[float, float]:
    """Return bounds of u for x = times u that keep x within its bounds despite rounding."""
    low, high = sorted(bound / times for bound in bounds)
    for _ in range(2):  # a quotient and a product, half a unit in the last place each
        if not bounds[0] <= times * low <= bounds[1]:
            low = math.nextafter(low, math.inf)
        if not bounds[0] <= times * high <= bounds[1]:
            high = math.nextafter(high, -math.inf)
    return low, high


class Groups:
    """Union-find of tied parameters, with their multiples."""

    def __init__(self) -> None:
        # Parent of each member, and the ratio of the member's value to the parent's value.
        self._parent: dict[Member, tuple[Member, float]] = {}
        self._rules: dict[Member, set[int]] = {}

    def tie(self, a: Member, b: Member, times: float, rule: int) -> bool:
        """Tie a = times b; return False if a is already a different multiple of b."""
        (root_a, of_a), (root_b, of_b) = self._find(a), self._find(b)
        if root_a == root_b:
            self._rules[root_a].add(rule)
            return _agree(of_a, times * of_b)
        # x_a = of_a u_a = times of_b u_b; the earlier root stays.
        if root_a <= root_b:
            self._parent[root_b] = root_a, of_a / (times * of_b)
            self._rules[root_a] |= self._rules.pop(root_b) | {rule}
        else:
            self._parent[root_a] = root_b, times * of_b / of_a
            self._rules[root_b] |= self._rules.pop(root_a) | {rule}
        return True

    def all(self) -> list[Group]:
        """Return the groups with several members, in ascending order."""
        members: dict[Member, list[tuple[Member, float]]] = {}
        for member in sorted(self._parent):
            root, times = self._find(member)
            members.setdefault(root, []).append((member, times))
        return [
            Group(tuple(found), tuple(sorted(self._rules[root])))
            for root, found in members.items()
            if len(found) > 1
        ]

    def of(self) -> Mapping[Member, Member]:
        """Return the root of each member."""
        return {member: self._find(member)[0] for member in self._parent}

    def _find(self, member: Member) -> tuple[Member, float]:
        if member not in self._parent:
            self._parent[member] = member, 1.0
            self._rules[member] = set()
        path, at = [], member
        while self._parent[at][0] != at:
            path.append(at)
            at = self._parent[at][0]
        times = 1.0
        for step in reversed(path):  # from the root downwards
            times = self._parent[step][1] * times
            self._parent[step] = at, times
        return at, times
