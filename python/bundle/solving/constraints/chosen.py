"""Lookup of the cameras, images, points and parameters that a rule names."""

from __future__ import annotations

from bundle.errors import InputError, brief
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.image_selection import named_images
from bundle.model.problem import Problem
from bundle.model.problem_keys import parameter_names
from bundle.solving.constraints.rules import Rule


class Chooser:
    """Lookup of the names of rules in one problem."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._indices: dict[str, dict[int, int]] = {}

    def indices(self, rule: Rule) -> list[int]:
        """Return the indices of the rule's cameras, images or points, ascending.

        Raises:
            InputError: the problem does not have an id or name of the rule.
        """
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

        Raises:
            InputError: a camera does not have the parameter; the message lists its parameters.
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
    """Return the names, and also "f" if the model has two focal lengths."""
    return ("f", *names) if "fx" in names and "f" not in names else names
