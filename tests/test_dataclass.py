# SPDX-License-Identifier: Apache-2.0
"""Our dataclasses behave like those of the standard library, and compile nothing."""

import copy
import dataclasses
import math
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl import dataclass as ours

Decorator = Callable[..., Callable[[type[Any]], type[Any]]]
OPTIONS = {"frozen": True, "slots": True, "kw_only": True}


def make_pair(decorate: Decorator) -> tuple[type[Any], type[Any]]:
    """Make a class and one that inherits from it."""

    @decorate(**OPTIONS)
    class Base:
        """Doubles what it is given."""

        first: int
        second: float = 1.5
        third: list[int] = field(default_factory=list)
        hidden: str = field(default="", repr=False)
        ignored: int = field(default=0, compare=False)

        def __post_init__(self) -> None:
            if self.first < 0:
                raise ValueError("negative")
            object.__setattr__(self, "second", self.second * 2)

    @decorate(**OPTIONS)
    class Child(Base):  # type: ignore[misc, unused-ignore]
        """Has another default, and a field more."""

        second: float = 2.5
        last: object = None

    return Base, Child


OURS, STANDARD = make_pair(ours.dataclass), make_pair(dataclasses.dataclass)
PICKLED = OURS[0]
PICKLED.__qualname__ = "PICKLED"
CALLS = [
    {"first": 1},
    {"first": 1, "second": 3.0},
    {"first": 1, "third": [1]},
    {"first": 1, "second": math.nan, "third": [], "hidden": "x", "ignored": 7},
    {"first": 2, "ignored": 7},
    {"first": -1},
    {},
    {"second": 1.0},
    {"first": 1, "unknown": 2},
    {"first": 1, "second": 2.0, "third": [], "hidden": "", "unknown": 2},
    {"unknown": 2},
]


def describe(kind: type[Any], given: dict[str, Any]) -> tuple[Any, ...]:
    """Return the values of a new object, and how it is printed; or the type of the error."""
    try:
        made = kind(**given)
    except (TypeError, ValueError) as error:
        return (type(error),)
    values = [getattr(made, each.name) for each in dataclasses.fields(made)]
    return values, repr(made).partition("(")[2], dataclasses.asdict(made)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("given", CALLS)
def test_objects_are_made_and_printed_alike(which: int, given: dict[str, Any]) -> None:
    assert repr(describe(OURS[which], given)) == repr(describe(STANDARD[which], given))


@given(st.lists(st.fixed_dictionaries({"first": st.integers(0, 2)}, optional={"second": st.sampled_from([1.0, math.nan]),
       "ignored": st.integers(0, 2), "last": st.sampled_from([None, 1, 1.0, True])}), min_size=2, max_size=2))  # fmt: skip
def test_objects_are_equal_alike(calls: list[dict[str, Any]]) -> None:
    """Of the same nan too: tuples compare objects by identity first."""
    one, other = (OURS[1](**call) for call in calls)
    standard = [STANDARD[1](**call) for call in calls]
    assert (one == other) is (standard[0] == standard[1])
    assert one == copy.copy(one)
    assert one != calls[0]
    assert one != OURS[0](first=one.first)


def test_equal_objects_have_one_hash() -> None:
    @ours.dataclass(frozen=True, slots=True, kw_only=True)
    class Key:
        name: str
        number: int = 0

    assert len({Key(name="a"), Key(name="a", number=0), Key(name="b")}) == 2
    with pytest.raises(TypeError):
        hash(OURS[0](first=1))


def test_one_field_that_is_not_equal_to_itself_is_equal_in_one_object() -> None:
    @ours.dataclass(frozen=True, slots=True, kw_only=True)
    class Reading:
        value: float

    @ours.dataclass(frozen=True, slots=True, kw_only=True)
    class Nothing:
        pass

    assert Reading(value=math.nan) == Reading(value=math.nan)
    assert Reading(value=float("nan")) != Reading(value=float("nan"))
    assert Nothing() == Nothing()
    assert repr(Nothing()).endswith("Nothing()")


def test_nothing_can_be_assigned() -> None:
    made = OURS[0](first=1)
    for name in ("first", "other"):
        with pytest.raises(FrozenInstanceError):
            setattr(made, name, 2)
    with pytest.raises(FrozenInstanceError):
        del made.first
    assert made.first == 1
    assert not hasattr(made, "__dict__")


def test_objects_are_copied_replaced_and_pickled() -> None:
    made = OURS[0](first=1, third=[1])
    copied = [copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made))]
    assert copied == [made] * 3
    assert dataclasses.replace(made, first=3, second=1.0).first == 3
    with pytest.raises(TypeError):
        dataclasses.replace(made, unknown=3)


def test_a_list_that_contains_its_object_is_printed() -> None:
    made = OURS[0](first=1)
    made.third.append(made)
    assert "third=[...]" in repr(made)


def make_positional(decorate: Decorator, **options: bool) -> type[Any]:
    @decorate(slots=True, **options)
    class Place:
        """Is given by position."""

        line: int
        column: int = 1
        words: list[str] = field(default_factory=list)
        last: int = field(default=0, kw_only=True)

    return Place


OTHER_KINDS: list[dict[str, bool]] = [{"frozen": True}, {}, {"eq": False}, {"frozen": True, "eq": False}]
POSITIONAL_CALLS: list[tuple[tuple[Any, ...], dict[str, Any]]] = [
    ((3,), {}),
    ((3, 4), {"last": 5}),
    ((3,), {"column": 4, "words": ["a"]}),
    ((), {"line": 3}),
    ((), {}),
    ((3,), {"line": 3}),
    ((3, 4, [], 5), {}),
    ((3,), {"other": 1}),
]


@pytest.mark.parametrize("options", OTHER_KINDS, ids=str)
@pytest.mark.parametrize(("given", "named"), POSITIONAL_CALLS)
def test_objects_given_by_position_are_made_alike(
    options: dict[str, bool], given: tuple[Any, ...], named: dict[str, Any]
) -> None:
    made = [
        describe_positional(make_positional(decorate, **options), given, named)
        for decorate in (ours.dataclass, dataclasses.dataclass)
    ]
    assert made[0] == made[1]


def describe_positional(kind: type[Any], given: tuple[Any, ...], named: dict[str, Any]) -> object:
    try:
        made = kind(*given, **named)
    except TypeError as error:
        return type(error)
    other = kind(*given, **named)
    no_hash: tuple[object, ...] = (None, object.__hash__)
    hashed = kind.__hash__ not in no_hash
    return dataclasses.astuple(made), repr(made).partition("(")[2], made == other, hashed, kind.__match_args__


def test_an_object_that_may_change_changes_and_has_no_hash() -> None:
    place = make_positional(ours.dataclass)(3)
    place.column += 1
    assert place.column == 2
    assert place == type(place)(3, 2)
    assert place != type(place)(3)
    assert place != 3
    assert copy.copy(place) == place
    with pytest.raises(TypeError):
        hash(place)
    with pytest.raises(AttributeError):
        place.other = 1


def test_a_frozen_object_given_by_position_is_frozen_and_pickled() -> None:
    place = FROZEN_PLACE(3, 4)
    with pytest.raises(FrozenInstanceError):
        place.line = 4
    assert pickle.loads(pickle.dumps(place)) == place
    assert dataclasses.replace(place, line=9) == FROZEN_PLACE(9, 4)


FROZEN_PLACE = make_positional(ours.dataclass, frozen=True)
FROZEN_PLACE.__qualname__ = "FROZEN_PLACE"


@pytest.mark.parametrize("options", [{}, {"kw_only": True}, {"frozen": True, "kw_only": True}], ids=str)
def test_a_field_that_is_not_given_is_set_later(options: dict[str, bool]) -> None:
    @ours.dataclass(slots=True, **options)
    class Search:
        first: int
        rest: dict[str, int] = field(default_factory=dict, init=False)
        total: int = field(init=False)

        def __post_init__(self) -> None:
            object.__setattr__(self, "total", self.first + len(self.rest))

    assert Search(first=2).total == 2
    with pytest.raises(TypeError):
        Search(first=2, rest={})  # type: ignore[call-arg]


@pytest.mark.parametrize("options", OTHER_KINDS, ids=str)
def test_a_class_of_many_objects_keeps_its_behaviour(options: dict[str, bool]) -> None:
    """From some number on its initializer is the one that the standard library compiles."""
    kind = make_positional(ours.dataclass, **options)
    first = kind.__init__
    made = [kind(number, last=2) for number in range(ours.COMPILE_AFTER + 1)]
    assert kind.__init__ is not first
    assert {each.last for each in made} == {2}
    assert [each.line for each in made] == list(range(len(made)))
    assert made[-1].words == []
    assert made[-1].words is not made[-2].words
    with pytest.raises(TypeError):
        kind(1, 2, [], 4)


def test_nothing_is_compiled() -> None:
    """The cost of the standard decorator is the compilation; the standard one shows that this test sees it."""
    source = (
        "import dataclasses, sys\nfrom edgectl import dataclass as ours\nseen = []\n"
        "sys.addaudithook(lambda event, _: seen.append(event) if event == 'compile' else None)\n"
        "for module in (ours, dataclasses):\n"
        "    @module.dataclass(frozen=True, slots=True, kw_only=True)\n"
        "    class Point:\n        x: int\n        y: int = 0\n"
        "    Point(x=1) == Point(x=2)\n"
        "    for options in ({'frozen': True}, {}, {'eq': False}):\n"
        "        @module.dataclass(slots=True, **options)\n"
        "        class Place:\n            x: int\n            y: int = 0\n"
        "        Place(1) == Place(x=2)\n"
        "    print(len(seen))\n"
    )
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    here, standard = map(int, done.stdout.split())
    assert here == 0
    assert standard > 0


def test_fields_are_replaced_as_by_the_standard_library() -> None:
    for made in make_pair(ours.dataclass):
        values = {"fourth": "x"} if "fourth" in {each.name for each in dataclasses.fields(made)} else {}
        value = made(first=1, third=[7], hidden="h", ignored=3, **values)
        for changes in ({}, {"first": 2}, {"third": [], "ignored": 9}):
            found = ours.replace_fields(value, **changes)
            assert found == dataclasses.replace(value, **changes)
            assert (found.hidden, found.ignored) == ("h", changes.get("ignored", 3))
            assert found is not value
        with pytest.raises(TypeError, match="unexpected keyword argument 'fifth'"):
            ours.replace_fields(value, fifth=1)
