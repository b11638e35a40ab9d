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


def test_other_kinds_are_those_of_the_standard_library() -> None:
    @ours.dataclass(slots=True)
    class Counter:
        value: int = 0

    counter = Counter(3)
    counter.value += 1
    assert counter == Counter(value=4)


def test_nothing_is_compiled() -> None:
    """The cost of the standard decorator is the compilation; the standard one shows that this test sees it."""
    source = (
        "import dataclasses, sys\nfrom edgectl import dataclass as ours\nseen = []\n"
        "sys.addaudithook(lambda event, _: seen.append(event) if event == 'compile' else None)\n"
        "for module in (ours, dataclasses):\n"
        "    @module.dataclass(frozen=True, slots=True, kw_only=True)\n"
        "    class Point:\n        x: int\n        y: int = 0\n"
        "    Point(x=1) == Point(x=2)\n"
        "    print(len(seen))\n"
    )
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    here, standard = map(int, done.stdout.split())
    assert here == 0
    assert standard > 0
