"""Classes of the rules, and the text of each rule.

A rule consists of a target, names of parameters of the target, and a statement about these
parameters. Targets are ``camera 3``, ``cameras 1-4``, ``cameras *``, ``image "left/*.jpg"`` or
``point 12``. ``rule_text.parse_rule`` reads the ``str()`` of a rule as the same rule.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import field
from typing import Any, ClassVar

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.model.problem_keys import MOST_IDS, id_range

TARGETS = ("camera", "image", "point")  # kinds of variables that rules can name
SHAPES = {"plane": ((4, 0), slice(3)), "level plane": ((0,), slice(3)), "line": ((6,), slice(3, 6))}
"""Shapes on which points lie: how many numbers they have (0: estimated), and the axis in these."""
POSES = ("position", "rotation")
"""Parameters of rules on images; the parameter of rules on points is the position."""


@dataclass(frozen=True)
class Target:
    """Target of a rule.

    Attributes:
        kind: "camera", "image" or "point".
        entries: ids, ranges of ids, and patterns of image names; None: all.
    """

    kind: str
    entries: tuple[range | str, ...] | None

    @staticmethod
    def of(text: Any) -> Target:
        """Return the target that a text such as "cameras 1-4" names; return a target unchanged.

        Raises:
            InputError: the text is not a target.
        """
        if isinstance(text, Target):
            return text
        if not isinstance(text, str):
            raise InputError(f'expected a target such as "camera 3", found {brief(text)}')
        word, _, rest = text.strip().partition(" ")
        kind = word.lower().removesuffix("s")
        rest = rest.strip()
        if kind not in TARGETS or not rest:
            raise InputError(
                "expected camera, cameras, image, images or points, then ids, * or a quoted name, "
                f"such as cameras 1-4, found {brief(text.strip())}"
            )
        if rest == "*":
            return Target(kind, None)
        return Target(kind, tuple(_entry(kind, part) for part in _split(rest)))

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        if self.entries is None:
            return f"{self.kind}s *"
        parts = [_text(entry) for entry in self.entries]
        one = len(self.entries) == 1 and (
            isinstance(self.entries[0], str) or len(self.entries[0]) == 1
        )
        return f"{self.kind}{'' if one else 's'} {','.join(parts)}"


def _text(entry: range | str) -> str:
    if isinstance(entry, str):
        return f"'{entry}'" if '"' in entry else f'"{entry}"'
    return f"{entry.start}" if len(entry) == 1 else f"{entry.start}-{entry.stop - 1}"


def _entry(kind: str, text: str) -> range | str:
    if len(text) > 2 and text[0] in "\"'" and text[-1] == text[0]:
        if kind != "image":
            raise InputError(f"expected ids of {kind}s, found the name {brief(text[1:-1])}")
        return text[1:-1]
    try:
        ids = id_range(text)
    except ValueError as error:
        raise InputError(str(error)) from None
    if ids is None:
        names = ', or names in quotes such as "left/*.jpg"' if kind == "image" else ""
        raise InputError(f"expected ids of {kind}s such as 3 or 1-4{names}, found {brief(text)}")
    if ids.stop - ids.start > MOST_IDS:
        raise InputError(f"expected at most {MOST_IDS} ids, found {text}")
    return ids


def _split(text: str) -> list[str]:
    """Split a text at commas outside quotes."""
    parts, quote = [""], ""
    for character in text:
        if character in "\"'" and quote in ("", character):
            quote = "" if quote else character
        if character == "," and not quote:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


@dataclass(frozen=True)
class Rule:
    """Base of all rules.

    Attributes:
        target: the cameras, images or points; also as text, such as "cameras 1-4".
        parameters: names of parameters, as a sequence or as text such as "f,k1". Cameras have
            COLMAP's names, and ``f`` for all focal lengths of a model with several. Images have
            "position" (the projection centre) and "rotation". Points have "position".
        place: place of the rule in its file or list, for messages.
    """

    target: Target
    parameters: tuple[str, ...]
    place: str = field(default="", kw_only=True, compare=False)

    kind: ClassVar[str] = ""
    """Kind of the rule in reports: "fixed", "prior", "on", "bounds", "share" or "ratio"."""

    def __post_init__(self) -> None:
        try:
            self._set("target", Target.of(self.target))
            self._set("parameters", _names(self.parameters))
            self._check()
        except InputError as error:
            subject = f"{self.place}: " if self.place else f"{type(self).__name__}: "
            raise InputError(f"{subject}{error}") from None

    def _check(self) -> None:
        known = {"image": POSES, "point": POSES[:1]}.get(self.target.kind, ())
        for name in self.parameters if known else ():
            if name not in known:
                raise InputError(
                    f"expected {' or '.join(known)} of {self.target.kind}s, found {brief(name)}"
                )

    def _only_cameras(self) -> None:
        if self.target.kind != "camera":
            raise InputError(f"expected fixed or prior for {self.target.kind}s, found {self.kind}")

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _head(self) -> str:
        return f"{self.target}: {','.join(self.parameters)}"


def _names(given: Any) -> tuple[str, ...]:
    try:
        names = given.split(",") if isinstance(given, str) else list(given)
        names = [name.strip() for name in names]
    except (TypeError, AttributeError):
        raise InputError(f"expected names of parameters, found {brief(given)}") from None
    if not all(names):
        raise InputError(f"expected names of parameters, found {brief(given)}")
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True)
class Fixed(Rule):
    """Rule that keeps parameters constant at their start values."""

    kind = "fixed"

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        return f"{self._head()} fixed"


@dataclass(frozen=True)
class Prior(Rule):
    """Rule with a Gaussian prior on parameters; each costs 1/2 ((x - value) / sigma)^2.

    Attributes:
        value: measured value: a number, or x, y and z of a position; None: the start value.
        sigma: standard deviation in the unit of the parameter. The unit is pixels for focal lengths
            and the principal point, degrees for rotations and the length unit of the reconstruction
            for positions; distortion has no unit. For positions: one number, (horizontal,
            vertical) with z up, or one number per axis.
        percent: standard deviation in percent of the value, instead of sigma. A focal length then
            costs 1/2 (log(f / value) / (percent / 100))^2.
    """

    value: float | tuple[float, ...] | None = None
    sigma: float | tuple[float, ...] | None = None
    percent: float | None = None

    kind = "prior"

    def _check(self) -> None:
        super()._check()
        if (self.sigma is None) == (self.percent is None):
            raise InputError("expected a sigma or a percentage, such as prior sigma 5 or prior 2 %")
        spread = "sigma" if self.percent is None else "percent"
        self._set(spread, _positive(spread, getattr(self, spread)))
        if self.value is not None:
            self._set("value", _finite("value", self.value))
        if self.target.kind == "camera":
            self._expect_numbers(("value", 1), ("sigma", 1))
            return
        if self.percent is not None:
            raise InputError(f"expected a sigma for {self.target.kind}s, found a percentage")
        if len(self.parameters) > 1:
            raise InputError("expected one rule for the position and one for the rotation")
        if self.parameters == ("rotation",):
            if self.value is not None:
                raise InputError(
                    "expected a prior of the rotation about its start, found a value "
                    f"{brief(self.value)}"
                )
            self._expect_numbers(("sigma", 1))
        else:
            self._expect_numbers(("value", 3), ("sigma", 1, 2, 3))

    def _expect_numbers(self, *expected: tuple[Any, ...]) -> None:
        for name, *counts in expected:
            value = getattr(self, name)
            found = len(value) if isinstance(value, tuple) else 1
            if value is not None and found not in counts:
                wanted = " or ".join(map(str, counts))
                raise InputError(
                    f"{name}: expected {wanted} number{'s' * (counts != [1])}, found {found}"
                )

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        value = "" if self.value is None else f" {_numbers(self.value)}"
        if self.percent is not None:
            return f"{self._head()} prior{value} {self.percent!r} %"
        assert self.sigma is not None
        return f"{self._head()} prior{value} sigma {_numbers(self.sigma)}"


@dataclass(frozen=True)
class On(Rule):
    """Rule that points lie on a plane or line; each costs 1/2 (distance / sigma)^2.

    Attributes:
        parameters: "plane", "level plane" (an unknown height z) or "line".
        numbers: a, b, c, d of the plane a x + b y + c z + d = 0, where (a, b, c) has any length; or
            x, y, z of a place on the line, then its direction. Without any, the plane is estimated.
        sigma: standard deviation of the distance, in the length unit of the reconstruction; of a
            line along each of two perpendicular axes.
    """

    numbers: tuple[float, ...]
    sigma: float

    kind = "on"

    def _check(self) -> None:
        if self.target.kind != "point" or self.parameters[1:] or self.parameters[0] not in SHAPES:
            raise InputError(f"expected points on plane or on line, found {self._head()}")
        counts, axis = SHAPES[self.parameters[0]]
        given: Any = self.numbers
        self._set("numbers", () if given in ((), []) else _finite("numbers", given))
        self._set("sigma", _positive("sigma", self.sigma))
        found = len(self.numbers) if isinstance(self.numbers, tuple) else 1
        if found not in counts or isinstance(self.sigma, tuple):
            raise InputError(
                f"expected {' or '.join(map(str, counts))} numbers of a {self.parameters[0]} and "
                f"one sigma, found {found}"
            )
        size = math.hypot(*self.numbers[axis])
        if found and not 1e-100 <= size <= 1e100:
            raise InputError(
                f"expected a normal or direction of a length above 0 (1e-100 to 1e100), found "
                f"{size:g}"
            )

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        words = (self.parameters[0], *map(repr, self.numbers))
        return f"{self.target}: on {' '.join(words)} sigma {self.sigma!r}"


@dataclass(frozen=True)
class Bounds(Rule):
    """Rule that keeps parameters between two numbers from the start; either may be infinite."""

    lower: float = -math.inf
    upper: float = math.inf

    kind = "bounds"

    def _check(self) -> None:
        self._only_cameras()
        for side in ("lower", "upper"):
            self._set(side, _number(side, getattr(self, side)))
        if not self.lower <= self.upper or self.lower == math.inf or self.upper == -math.inf:
            raise InputError(
                "expected bounds [lower, upper] with lower at most upper, "
                f"found [{self.lower:g}, {self.upper:g}]"
            )

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        return f"{self._head()} in [{self.lower!r}, {self.upper!r}]"


@dataclass(frozen=True)
class Share(Rule):
    """Rule that gives a parameter one value in all cameras of the target.

    If all these cameras have fx and fy, ``f`` shares fx and fy separately. If some have a single
    focal length, ``f`` makes all focal lengths of all these cameras equal.
    """

    kind = "share"

    def _check(self) -> None:
        self._only_cameras()

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        return f"{self.target}: share {','.join(self.parameters)}"


@dataclass(frozen=True)
class Ratio(Rule):
    """Rule that keeps the ratio of two parameters of each camera constant at its start value.

    Attributes:
        parameters: the two names, numerator first.
    """

    kind = "ratio"

    def _check(self) -> None:
        self._only_cameras()
        if len(self.parameters) != 2:
            raise InputError(
                f"expected two different parameters, such as fx/fy, found "
                f"{'/'.join(self.parameters)}"
            )

    def __str__(self) -> str:
        """Return the text of this object, which the parser reads."""
        return f"{self.target}: {'/'.join(self.parameters)} fixed"


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool):
        raise InputError(f"{name}: expected a number, found {brief(value)}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: expected a number, found {brief(value)}") from None
    if math.isnan(number):
        raise InputError(f"{name}: expected a number, found nan")
    return number


def _finite(name: str, value: Any) -> float | tuple[float, ...]:
    """Return a number, or a tuple of several, all finite."""
    if isinstance(value, Iterable) and not isinstance(value, str | bytes):
        numbers = tuple(_one(name, entry) for entry in value)
        return numbers[0] if len(numbers) == 1 else numbers
    return _one(name, value)


def _one(name: str, value: Any) -> float:
    number = _number(name, value)
    if math.isinf(number):
        raise InputError(f"{name}: expected a finite number, found {number:g}")
    return number


def _positive(name: str, value: Any) -> float | tuple[float, ...]:
    numbers = _finite(name, value)
    for number in numbers if isinstance(numbers, tuple) else (numbers,):
        # Beyond these limits the weight 1 / sigma^2 is zero or infinite.
        if not 1e-100 <= number <= 1e100:
            raise InputError(
                f"{name}: expected a number above 0 (1e-100 to 1e100), found {number:g}"
            )
    return numbers


def _numbers(value: float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(repr, value))}]"
    return repr(value)
