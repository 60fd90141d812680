"""Frozen classes behave as those of the standard library, which is the oracle."""

import copy
import dataclasses
import inspect
import pickle
import typing
from dataclasses import field
from types import SimpleNamespace

import pytest

import bundle.base.records as records


def classes(dataclass):
    """Return classes of every kind that the package uses, made by a decorator."""

    @dataclass(frozen=True)
    class Point:
        """Two numbers."""

        x: int
        y: "float" = 2.5
        kind: typing.ClassVar[str] = "point"

    @dataclass(frozen=True, kw_only=True)
    class Named:
        """Keywords, of which not all are shown, compared or hashed."""

        name: str
        tags: list[str] = field(default_factory=list, hash=False)
        note: str = field(default="", repr=False, compare=False)

    @dataclass(frozen=True)
    class Mixed:
        """Places and keywords in another order, and values that are made later."""

        key: str = field(default="k", kw_only=True)
        value: int
        twice: int = field(init=False)
        made: dict[str, int] = field(init=False, default_factory=dict)
        fixed: int = field(init=False, default=7)

        def __post_init__(self) -> None:
            object.__setattr__(self, "twice", 2 * self.value)

    @dataclass(frozen=True, eq=False)
    class Identity:
        """Compared by identity."""

        other: typing.Any = None

    @dataclass(frozen=True, repr=False)
    class Own:
        """Own methods, which stay."""

        x: int = 0

        def __repr__(self) -> str:
            return "own"

        def __eq__(self, other: object) -> bool:
            return True

    @dataclass(frozen=True, init=False)
    class Made:
        """An own constructor."""

        x: int

        def __init__(self, text: str) -> None:
            object.__setattr__(self, "x", int(text))

    @dataclass(frozen=True)
    class Empty:
        """No fields."""

    @dataclass(frozen=True)
    class Text:
        """Annotations in text, as in modules that postpone them."""

        x: "int"
        tags: "list[str]" = field(default_factory=list)
        y: "float | None" = None

    @dataclass(frozen=True)
    class Special:
        """Annotations in text that are no fields."""

        x: "int"
        kind: "typing.ClassVar[str]" = "special"
        _: "dataclasses.KW_ONLY"
        y: "int" = 2

    @dataclass(frozen=True, kw_only=True)
    class Solid(Point):
        """A class that derives from another one."""

        z: int = 3

    class Plain(Point):
        """A class with attributes beside the fields."""

    @dataclass
    class Free:
        """Not frozen."""

        x: int = 1

    @dataclass(frozen=True, unsafe_hash=True)
    class Hashed:
        """A method that the standard library would refuse to replace."""

        x: int = 1

    @dataclass(frozen=True, slots=True)
    class Slots:
        """A new class in place of the given one."""

        x: int = 1

    @dataclass(frozen=True)
    class Undocumented:
        x: int = 1

    return SimpleNamespace(**{name: one for name, one in locals().items() if name[0].isupper()})


OURS, ORACLE = classes(records.dataclass), classes(dataclasses.dataclass)


@pytest.fixture(params=[-1, 10**9], ids=["compiled", "not compiled"], autouse=True)
def new_classes(request, monkeypatch):
    monkeypatch.setattr(records, "MOST_USES", request.param)
    monkeypatch.setitem(globals(), "OURS", classes(records.dataclass))


NAMES = sorted(vars(OURS))
CALLS = [
    ("Point", (1,), {}),
    ("Point", (1, 2), {}),
    ("Point", (), {"y": 3, "x": (1, 2)}),
    ("Point", ([],), {}),  # has no hash
    ("Named", (), {"name": "a"}),
    ("Named", (), {"name": "a", "tags": ["b"], "note": "c"}),
    ("Named", (), {"name": "a", "tags": [], "note": "d"}),
    ("Mixed", (4,), {}),
    ("Mixed", (4,), {"key": "l"}),
    ("Own", (), {}),
    ("Own", (3,), {}),
    ("Made", ("12",), {}),
    ("Empty", (), {}),
    ("Text", (1,), {}),
    ("Text", (1, ["a"]), {"y": 0.5}),
    ("Special", (1,), {"y": 3}),
    ("Solid", (1,), {}),
    ("Solid", (1, 2), {"z": 5}),
    ("Plain", (1,), {}),
    ("Free", (2,), {}),
    ("Hashed", (2,), {}),
    ("Slots", (2,), {}),
    ("Undocumented", (2,), {}),
]
WRONG = [
    ("Point", (), {}),
    ("Point", (1, 2, 3), {}),
    ("Point", (1,), {"z": 1}),
    ("Point", (1,), {"x": 1}),
    ("Named", ("a",), {}),
    ("Named", (), {}),
    ("Mixed", (), {}),
    ("Mixed", (1,), {"twice": 2}),
    ("Empty", (1,), {}),
    ("Text", (), {}),
    ("Special", (1, 2), {}),
]


def of_both(name, places, keywords):
    return [getattr(made, name)(*places, **keywords) for made in (OURS, ORACLE)]


def outcome(work):
    """Return the result or the error of a call, as text."""
    try:
        return str(work())
    except Exception as error:
        return f"{type(error).__name__}: {error}".replace("classes.<locals>.", "")


@pytest.mark.parametrize("name", NAMES)
def test_classes_have_the_same_fields_and_signatures(name):
    ours, oracle = getattr(OURS, name), getattr(ORACLE, name)
    for one, other in zip(dataclasses.fields(ours), dataclasses.fields(oracle), strict=True):
        assert repr(one).replace(" object at", "") == repr(other).replace(" object at", "")
    assert str(inspect.signature(ours)) == str(inspect.signature(oracle))
    assert ours.__annotations__ == oracle.__annotations__
    assert ours.__init__.__annotations__ == oracle.__init__.__annotations__
    assert ours.__match_args__ == oracle.__match_args__
    assert repr(ours.__dataclass_params__) == repr(oracle.__dataclass_params__)
    assert ours.__doc__ == oracle.__doc__
    assert (ours.__hash__ is None) == (oracle.__hash__ is None)


@pytest.mark.parametrize(("name", "places", "keywords"), CALLS)
@pytest.mark.parametrize(
    "work",
    [
        repr,
        hash,
        vars,
        dataclasses.asdict,
        dataclasses.astuple,
        lambda made: vars(dataclasses.replace(made, x=9)),
        lambda made: made == copy.copy(made),
        lambda made: made == 1,
        lambda made: setattr(made, "x", 1),
        lambda made: setattr(made, "another", 1),
        lambda made: delattr(made, "x"),
        lambda made: delattr(made, "another"),
    ],
)
def test_objects_are_the_same(name, places, keywords, work):
    ours, oracle = of_both(name, places, keywords)
    assert outcome(lambda: work(ours)) == outcome(lambda: work(oracle))


@pytest.mark.parametrize("first", CALLS, ids=str)
def test_comparisons_are_the_same(first):
    ours, oracle = of_both(*first)
    for second in CALLS:
        other, its = of_both(*second)
        assert (ours == other) is (oracle == its)
        if not is_hashable(oracle) or not is_hashable(its):
            continue
        assert (hash(ours) == hash(other)) is (hash(oracle) == hash(its))


def is_hashable(made):
    return not outcome(lambda: hash(made)).startswith("TypeError")


@pytest.mark.parametrize(("name", "places", "keywords"), WRONG)
def test_wrong_calls_are_refused_with_the_same_message(name, places, keywords):
    ours, oracle = (
        outcome(lambda made=made: getattr(made, name)(*places, **keywords))
        for made in (OURS, ORACLE)
    )
    assert ours == oracle
    assert ours.startswith("TypeError")


def test_identity_and_recursion():
    one, other = OURS.Identity(), OURS.Identity()
    assert one == one and one != other and hash(one) != hash(other)
    for made in (OURS.Identity(), ORACLE.Identity()):
        object.__setattr__(made, "other", made)
        assert repr(made).endswith("Identity(other=...)")


def test_every_object_gets_its_own_made_value():
    assert OURS.Named(name="a").tags is not OURS.Named(name="a").tags
    assert OURS.Mixed(1).made is not OURS.Mixed(1).made
    assert OURS.Named(name="a", tags=list).tags is list  # as the factory, but given


def test_a_constructor_is_compiled_if_it_is_used_often(monkeypatch):
    monkeypatch.setattr(records, "MOST_USES", 3)
    constructor = vars(OURS.Mixed)["__init__"]
    made = [OURS.Mixed(k, key="l") for k in range(3)]
    assert vars(OURS.Mixed)["__init__"] is constructor
    made.append(OURS.Mixed(3, key="l"))
    assert inspect.isfunction(vars(OURS.Mixed)["__init__"])
    assert [vars(one) for one in made] == [vars(ORACLE.Mixed(k, key="l")) for k in range(4)]


def test_a_class_of_the_standard_library_derives_from_ours():
    @dataclasses.dataclass(frozen=True)
    class Derived(OURS.Point):
        z: int = 0

    assert repr(Derived(1, 2, 3)).endswith("Derived(x=1, y=2, z=3)")
    assert Derived(1) == Derived(1, 2.5)
    with pytest.raises(TypeError):
        dataclasses.dataclass(type("Free", (OURS.Point,), {"__doc__": "Not frozen."}))
    with pytest.raises(TypeError):
        records.dataclass(frozen=True)(type("Frozen", (OURS.Free,), {"__doc__": "Frozen."}))


def test_values_for_the_constructor_alone_are_refused():
    kind = type(
        "Set", (), {"__doc__": "Doc.", "__annotations__": {"x": "dataclasses.InitVar[int]"}}
    )
    with pytest.raises(TypeError, match="InitVar"):
        records.dataclass(frozen=True)(kind)


@records.dataclass(frozen=True)
class Kept:
    """At the top of the module, where pickle finds it."""

    x: int
    y: "list[Kept]" = field(default_factory=list)


def test_objects_survive_pickling_and_matching():
    one = Kept(1, [Kept(2)])
    assert pickle.loads(pickle.dumps(one)) == one
    assert typing.get_type_hints(Kept.__init__) == {"x": int, "y": list[Kept], "return": type(None)}
    match one:
        case Kept(1, [Kept(x)]):
            assert x == 2
        case _:
            pytest.fail("no match")
