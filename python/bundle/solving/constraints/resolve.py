"""Resolution of rules into the constants, bounds, ties and priors of a problem."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Set
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.arrays import at
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.problem_keys import named_images, parameter_names
from bundle.solving.constraints.constant_parts import (
    MOST_SHARED,
    ConstantParts,
    Group,
    Groups,
    Member,
    check_components,
    divided_bounds,
)
from bundle.solving.constraints.ends import (
    HELD_POSITION,
    HELD_ROTATION,
    Applied,
    Flatness,
    KnownPrior,
    Tie,
)
from bundle.solving.constraints.rule_list import rules_of
from bundle.solving.constraints.rules import SHAPES, Bounds, Fixed, On, Prior, Ratio, Rule, Share

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor

MOST_ON_A_PLANE = 1000  # points of an estimated plane, whose distances all depend on each other
PARTS = {"rotation": HELD_ROTATION, "position": HELD_POSITION}


def apply(
    constraints: Iterable[str | Rule] | Any,
    problem: Problem,
    options: SolveOptions,
    part: Mapping[str, Set[int]] | None = None,
) -> tuple[Problem, Applied | None]:
    """Return the start of a solve, with shared parameters made equal, and the resolved rules.

    Args:
        constraints: the rules.
        problem: the problem with the cameras, images and points that the rules name.
        options: options; their fixed ids and ``refine`` make parameters constant, too.
        part: ids of the refined cameras, images and points; None: all. Rules have no effect on the
            others.
    """
    rules = rules_of(constraints)
    if not rules:
        return problem, None
    return _Resolver(rules, problem, options, part).resolve()


class _Resolver(ConstantParts):
    def __init__(
        self,
        rules: tuple[Rule, ...],
        problem: Problem,
        options: SolveOptions,
        part: Mapping[str, Set[int]] | None,
    ) -> None:
        super().__init__(rules, problem, options, part)
        self._chooser = Chooser(problem)
        self._groups = Groups()
        self._known: dict[Any, int] = {}  # rule with a prior on the key
        self._priors: list[KnownPrior] = []
        self._counts = [0] * len(rules)

    def resolve(self) -> tuple[Problem, Applied]:
        """Return the start and the resolved rules."""
        for number, rule in enumerate(self._rules):
            if isinstance(rule, Fixed):
                self._fix(number, rule)
            elif isinstance(rule, Bounds):
                self._bound(number, rule)
            elif isinstance(rule, Share):
                self._share(number, rule)
            elif isinstance(rule, Ratio):
                self._tie_ratio(number, rule)
        ties, held = self._settle_ties()
        self._check_bounds()
        for number, rule in enumerate(self._rules):
            if isinstance(rule, Prior):
                self._know(number, rule, held)
            elif isinstance(rule, On):
                self._lay_on(number, rule)
        problem = self._problem
        camera_ids = problem.camera_ids.tolist()
        held_params: dict[int, set[int]] = {}
        for camera, j in (*self._fixed, *held):
            held_params.setdefault(camera_ids[camera], set()).add(j)
        held_poses: dict[int, int] = {}
        for image, part in self._poses:
            key = int(problem.image_ids[image])
            held_poses[key] = held_poses.get(key, 0) | PARTS[part]
        if not np.array_equal(self._params, problem.camera_params):
            problem = problem.replace(camera_params=self._params)
        factors: tuple[Factor, ...] = tuple(factor_of(prior) for prior in self._priors)
        return problem, Applied(
            rules=self._rules,
            held_params={key: frozenset(columns) for key, columns in held_params.items()},
            held_poses=held_poses,
            fixed_point_ids=tuple(int(problem.point_ids[point]) for point in self._points),
            bounds={(camera_ids[c], j): pair for (c, j), pair in self._bounds.items()},
            priors=tuple(self._priors),
            factors=factors,
            ties=ties,
            counts=tuple(self._counts),
            bounded={(camera_ids[c], j): rule for (c, j), rule in self._bounded.items()},
        )

    def _fix(self, number: int, rule: Fixed) -> None:
        if rule.target.kind == "camera":
            for camera, _, columns in self._chooser.parameters(rule):
                for j in columns:
                    self._fixed.setdefault((camera, j), number)
                    self._counts[number] += 1
            return
        for index in self._chooser.indices(rule):
            if rule.target.kind == "point":
                self._points.setdefault(index, number)
                self._counts[number] += 1
                continue
            if rule.target.kind == "image" and self._is_on_rig(index):
                raise InputError(
                    f"{rule.place}: expected images with a pose of their own, found image "
                    f"{self._problem.image_ids[index]} on a rig; fix its frame with fixed_image_ids"
                )
            for part in rule.parameters:
                self._poses.setdefault((index, part), number)
                self._counts[number] += 1

    def _bound(self, number: int, rule: Bounds) -> None:
        for camera, _, columns in self._chooser.parameters(rule):
            for j in columns:
                member = camera, j
                if member in self._bounded and self._bounded[member] != number:
                    raise InputError(
                        f"{rule.place}: {self._name(member)} already has bounds, by "
                        f"{self._place(self._bounded[member])}"
                    )
                self._bounded[member] = number
                self._bounds[member] = rule.lower, rule.upper
                self._counts[number] += 1

    def _share(self, number: int, rule: Share) -> None:
        chosen = self._chooser.parameters(rule)
        for name in rule.parameters:
            cameras = [(camera, columns) for camera, other, columns in chosen if other == name]
            sizes = {len(columns) for _, columns in cameras}
            self._counts[number] += sum(len(columns) for _, columns in cameras)
            if len(sizes) == 1:
                slots = [[(c, columns[k]) for c, columns in cameras] for k in range(sizes.pop())]
            else:  # f of a model with one focal length, and of one with two
                slots = [[(c, j) for c, columns in cameras for j in columns]]
            for members in slots:
                for member in members[1:]:
                    self._tie(number, rule, members[0], member, 1.0)

    def _tie_ratio(self, number: int, rule: Ratio) -> None:
        chosen = self._chooser.parameters(rule)
        first = {camera: columns for camera, name, columns in chosen if name == rule.parameters[0]}
        second = {camera: columns for camera, name, columns in chosen if name == rule.parameters[1]}
        for camera, columns in first.items():
            if camera not in second:
                continue
            if len(columns) > 1 or len(second[camera]) > 1:
                raise InputError(
                    f"{rule.place}: expected the names of two parameters, found f of camera "
                    f"{self._problem.camera_ids[camera]}, which has fx and fy"
                )
            a, b = (camera, columns[0]), (camera, second[camera][0])
            self._counts[number] += 2
            for member in (a, b):
                if self._params[member] == 0:
                    raise InputError(
                        f"{rule.place}: expected a ratio of nonzero parameters, found "
                        f"{self._name(member)} = 0"
                    )
            self._tie(number, rule, a, b, float(self._params[a] / self._params[b]))

    def _tie(self, number: int, rule: Rule, a: Member, b: Member, times: float) -> None:
        if not self._groups.tie(a, b, times, number):
            raise InputError(
                f"{rule.place}: {self._name(a)} and {self._name(b)} are already tied by other "
                "rules, in another ratio"
            )

    def _settle_ties(self) -> tuple[tuple[Tie, ...], set[Member]]:
        """Change the start so that ties hold; return the free ties and the constant members."""
        ties, held = [], set[Member]()
        camera_ids = self._problem.camera_ids.tolist()
        groups = self._groups.all()
        excess = check_components(groups)
        if excess is not None:
            raise InputError(
                f"{self._place(excess.rules[-1])}: expected at most {MOST_SHARED} shared numbers "
                "in a group of connected cameras, found more in that of "
                f"{self._name(excess.members[0][0])}"
            )
        for group in groups:
            with at(self._rules[group.rules[-1]].place):
                u, is_held = group.start(
                    lambda member: float(self._params[member]),
                    lambda member: self._why_held(member) != "",
                    self._name,
                )
            self._bound_group(group, u)
            for member, times in group.members:
                self._params[member] = times * u
            if is_held:
                held.update(member for member, _ in group.members)
            else:
                members = tuple((camera_ids[c], j, times) for (c, j), times in group.members)
                ties.append(Tie(members, group.rules))
        return tuple(ties), held

    def _bound_group(self, group: Group, u: float) -> None:
        """Apply the bounds of each member of a group to all its members."""
        lower, upper, by = -math.inf, math.inf, -1
        for member, times in group.members:
            if member not in self._bounds:
                continue
            low, high = divided_bounds(self._bounds[member], times)
            lower, upper, by = max(lower, low), min(upper, high), self._bounded[member]
            if not lower <= u <= upper:
                place, name = self._place(self._bounded[member]), self._name(member)
                raise InputError(
                    f"{place}: {name}: expected bounds that contain the shared start "
                    f"{times * u:.10g}, found [{times * lower:g}, {times * upper:g}]"
                )
        if by < 0:
            return
        for member, times in group.members:
            low, high = sorted((times * lower, times * upper))
            # Rounding of the multiples must not put the start out of bounds.
            self._bounds[member] = min(low, times * u), max(high, times * u)
            self._bounded.setdefault(member, by)

    def _know(self, number: int, rule: Prior, held: set[Member]) -> None:
        if rule.target.kind == "camera":
            self._know_parameters(number, rule, held)
            return
        (name,) = rule.parameters
        kind = rule.target.kind
        ids = getattr(self._problem, f"{kind}_ids")
        places = self._problem.points if kind == "point" else self._problem.projection_centers
        for index in self._chooser.indices(rule):
            key = int(ids[index])
            if self._is_outside(kind, key):
                continue
            self._expect_first(number, (kind, index, name), f"the {name} of {kind} {key}")
            self._expect_free(rule, kind, index, name)
            self._counts[number] += 1
            sigma = _tuple(rule.sigma)
            if name == "rotation":
                value = tuple(self._problem.cam_from_world[index].tolist())
            else:
                value = tuple(places[index].tolist()) if rule.value is None else _tuple(rule.value)
                sigma = sigma if len(sigma) == 3 else (sigma[0], sigma[0], sigma[-1])
            self._priors.append(KnownPrior(number, (kind, key), name, value, sigma))

    def _flatten(self, number: int, rule: On) -> None:
        """Add the factor of points on a plane that the solve estimates."""
        (shape,) = rule.parameters
        rows, is_level = self._chooser.indices(rule), shape == "level plane"
        ids = tuple(self._problem.point_ids[rows].tolist())
        if any(self._is_outside("point", key) for key in ids):
            raise InputError(f"{rule.place}: an unknown plane needs points of refined images only")
        self._expect_first(number, ("on", shape, ids), f"the {shape} of these points")
        least = 2 if is_level else 4
        if not least <= len(ids) <= MOST_ON_A_PLANE:
            raise InputError(
                f"{rule.place}: expected {least} to {MOST_ON_A_PLANE} points on an unknown "
                f"{shape}, found {len(ids)}"
            )
        if all(self._why_pose_held("point", index, "position") for index in rows):
            self._expect_free(rule, "point", rows[0], "position")
        points = self._problem.points[rows]
        sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1:]
        if not is_level and not sizes[1] > 1e-9 * sizes[0]:
            raise InputError(f"{rule.place}: expected points that are not on one line")
        normal = None if is_level else tuple(axes[2].tolist())
        self._counts[number] = len(ids)
        flatness = Flatness(ids, rule.sigma, normal)
        subject = ("point", ids[0])
        self._priors.append(
            KnownPrior(number, subject, shape, (), (rule.sigma,), flatness=flatness)
        )

    def _lay_on(self, number: int, rule: On) -> None:
        (shape,) = rule.parameters
        if not rule.numbers:
            self._flatten(number, rule)
            return
        numbers = np.array(rule.numbers)
        along = numbers[SHAPES[shape][1]]
        unit = along / np.linalg.norm(along)
        if shape == "plane":
            normals, place = unit[None], -unit * numbers[3] / np.linalg.norm(along)
        else:
            normals = np.linalg.svd(unit[None])[2][1:]
            place = normals.T @ (normals @ numbers[:3])
        sign = np.sign(unit[np.abs(unit).argmax()])
        same = tuple(np.round([*(sign * unit), *place], 9).tolist())
        for index in self._chooser.indices(rule):
            key = int(self._problem.point_ids[index])
            if self._is_outside("point", key):
                continue
            self._expect_first(number, ("on", index, shape, same), f"the {shape} of point {key}")
            self._expect_free(rule, "point", index, "position")
            self._counts[number] += 1
            point = self._problem.points[index]
            foot = point - normals.T @ (normals @ (point - place))
            self._priors.append(
                KnownPrior(
                    *(number, ("point", key), shape, tuple(foot.tolist()), (rule.sigma,)),
                    normals=tuple(map(tuple, normals.tolist())),
                )
            )

    def _expect_free(self, rule: Rule, kind: str, index: int, name: str) -> None:
        why = self._why_pose_held(kind, index, name)
        if why:
            key = int(getattr(self._problem, f"{kind}_ids")[index])
            raise InputError(
                f"{rule.place}: expected a prior on a refined parameter, found the {name} of "
                f"{kind} {key}, which {why}"
            )

    def _know_parameters(self, number: int, rule: Prior, held: set[Member]) -> None:
        root_of = self._groups.of()
        said: set[Member] = set()
        for camera, _, columns in self._chooser.parameters(rule):
            key = int(self._problem.camera_ids[camera])
            if self._is_outside("camera", key):
                continue
            model = self._problem.camera_models[camera]
            for j in columns:
                member = camera, j
                self._expect_first(number, ("camera", member), self._name(member))
                why = self._why_held(member) or (
                    "is constant because a parameter that it shares is constant" * (member in held)
                )
                if why:
                    raise InputError(
                        f"{rule.place}: expected a prior on a refined parameter, found "
                        f"{self._name(member)}, which {why}"
                    )
                self._counts[number] += 1
                root = root_of.get(member, member)
                if root in said:
                    continue  # one prior on a number that cameras share
                said.add(root)
                value = float(self._params[member]) if rule.value is None else _one(rule.value)
                is_focal = param_kinds(model)[j] == "focal"
                sigma = _one(rule.sigma) if rule.sigma is not None else _one(rule.percent) / 100
                if rule.percent is not None:
                    if value == 0 or (is_focal and value < 0):
                        raise InputError(
                            f"{rule.place}: {self._name(member)}: expected a value "
                            f"{'above' if is_focal else 'other than'} 0 for a prior in percent, "
                            f"found {value:g}; give a sigma"
                        )
                    sigma *= 1 if is_focal else abs(value)
                self._priors.append(
                    KnownPrior(
                        number,
                        ("camera", key),
                        camera_models()[model][j],
                        (value,),
                        (sigma,),
                        rule.percent is not None and is_focal,
                        j,
                    )
                )

    def _expect_first(self, number: int, what: Any, name: str) -> None:
        earlier = self._known.setdefault(what, number)
        if earlier != number:
            raise InputError(
                f"{self._place(number)}: {name} already has a prior, by {self._place(earlier)}"
            )


def _tuple(value: Any) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)


def _one(value: Any) -> float:
    return float(_tuple(value)[0])


class Chooser:
    """Lookup of the names of rules in one problem."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._indices: dict[str, dict[int, int]] = {}

    def indices(self, rule: Rule) -> list[int]:
        """Return the indices of the rule's cameras, images or points, ascending."""
        target = rule.target
        known = self._known(target.kind)
        if target.entries is None:
            if not known:
                raise InputError(f"{rule.place}: there are no {target.kind}s in the problem")
            return list(known.values())
        found: set[int] = set()
        for entry in target.entries:
            if isinstance(entry, str):
                ids = named_images(rule.place, self._problem, entry)
                found.update(known[image_id] for image_id in ids)
                continue
            for number in entry:
                if number not in known:
                    raise InputError(
                        f"{rule.place}: there is no {target.kind} {number} in the problem"
                    )
                found.add(known[number])
        return sorted(found)

    def parameters(self, rule: Rule) -> list[tuple[int, str, tuple[int, ...]]]:
        """Return (camera index, name, columns) of each parameter that the rule names.

        For a model with several focal lengths, ``f`` has the columns of all of them.
        ``cameras *`` leaves out the cameras whose model does not have the parameter.
        """
        cameras = self.indices(rule)
        every = rule.target.entries is None
        found: list[tuple[int, str, tuple[int, ...]]] = []
        columns: dict[tuple[str, str], tuple[int, ...]] = {}
        models = self._problem.camera_models
        for name in rule.parameters:
            before = len(found)
            for camera in cameras:
                model = models[camera]
                if (model, name) not in columns:
                    columns[model, name] = _columns(model, name)
                if columns[model, name]:
                    found.append((camera, name, columns[model, name]))
                elif not every:
                    names = parameter_names(rule.place, self._problem, camera)
                    raise InputError(
                        f"{rule.place}: camera {self._problem.camera_ids[camera]} ({model}) has no "
                        f"parameter {brief(name)}; expected one of {', '.join(_and_f(names))}"
                    )
            if len(found) == before:
                names = tuple(
                    dict.fromkeys(
                        other for m in dict.fromkeys(models) for other in camera_models().get(m, ())
                    )
                )
                raise InputError(
                    f"{rule.place}: no camera has a parameter {brief(name)}; "
                    f"expected one of {', '.join(_and_f(names))}"
                )
        return found

    def _known(self, kind: str) -> dict[int, int]:
        if kind not in self._indices:
            ids = getattr(self._problem, f"{kind}_ids").tolist()
            self._indices[kind] = {known: index for index, known in enumerate(ids)}
        return self._indices[kind]


def _columns(model: str, name: str) -> tuple[int, ...]:
    names = camera_models().get(model, ())
    if name in names:
        return (names.index(name),)
    if name != "f" or not names:
        return ()
    return tuple(j for j, kind in enumerate(param_kinds(model)) if kind == "focal")


def _and_f(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the parameter names of a model, with "f" if it has two focal lengths."""
    return ("f", *names) if "fx" in names and "f" not in names else names


def factor_of(prior: KnownPrior) -> Factor:
    """Return the factor whose whitened residual is the prior's pull in sigmas.

    For a rotation this residual is Log(R0^T R) / sigma. The factor is then a
    :class:`bundle.LinearPrior` on the pose, with zero information on the position.
    """
    from bundle.graphs.factors.factors import (
        FunctionFactor,
        PositionFactor,
        PriorFactor,
        ScalarPriorFactor,
    )
    from bundle.graphs.factors.linear_prior import LinearPrior, SquareRootPrior

    key = prior.subject
    if prior.flatness is not None:
        keys = tuple(("point", one) for one in prior.flatness.points)
        num_of_plane = 1 if prior.flatness.normal is None else 3
        factor = FunctionFactor(keys, prior.flatness, num_of_plane)
        factor.__dict__["name"] = f"{prior.parameter} of {plural(len(keys), 'point')}"
        return factor
    if prior.normals:
        root = np.array(prior.normals) / prior.sigma[0]
        return SquareRootPrior(root, np.zeros(len(root)), {key: prior.value}, (key,))
    if key[0] == "camera":
        (value,), (sigma,) = prior.value, prior.sigma
        return ScalarPriorFactor(key, prior.column, value, sigma, relative=prior.relative)
    if prior.parameter == "rotation":
        weight = 1 / math.radians(prior.sigma[0]) ** 2
        return LinearPrior(
            np.diag([weight] * 3 + [0.0] * 3),
            np.zeros(6),
            {key: prior.value},
            (key,),
            manifolds={key: "se3"},
        )
    information = np.diag(1 / np.array(prior.sigma) ** 2)
    if key[0] == "image":
        return PositionFactor(key, prior.value, information)
    return PriorFactor(key, prior.value, information)
