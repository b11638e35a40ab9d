# SPDX-License-Identifier: Apache-2.0
"""``dataclass`` of the standard library, which compiles nothing for a class with slots.

The standard one compiles six methods per class, half a millisecond of CPU, which was half of the time of
importing edgectl. Those made here are closures over the fields; they behave alike and take as long (ADR 99).
Each is made when it is first called: half of the classes of a command never get an object (ADR 164). Only the
initializer of a class of which a process makes many objects is compiled after all (ADR 134).
"""

import dataclasses
from collections.abc import Callable
from dataclasses import MISSING, FrozenInstanceError, fields
from functools import cache, partial
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

T = TypeVar("T")
Method = Callable[..., Any]
# The options of a class that is made here, all with slots.
_OPTIONS = {"frozen", "slots", "kw_only", "eq"}
# Objects of a class from which on a compiled initializer (0.2 ms to make, 1 us saved by each object) pays.
COMPILE_AFTER = 1000

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(**options: bool) -> Callable[[type[T]], type[T]]:
        """As the standard one; a class with slots gets its methods here, unless it is ordered."""
        made_here = options.get("slots") and options.keys() <= _OPTIONS
        return partial(_make_class, **options) if made_here else dataclasses.dataclass(**options)


@cache
def _make_copier(cls: type[Any]) -> tuple[Method, dict[str, Method], Method | None]:
    """What reads all fields of an object, what sets each of them, and what is called then."""
    setters = {each.name: getattr(cls, each.name).__set__ for each in fields(cls)}
    names = list(setters)
    # Of one name attrgetter makes no tuple.
    return attrgetter(*names, *names[-1:]), setters, getattr(cls, "__post_init__", None)


def replace_fields(value: T, /, **changes: object) -> T:
    """As ``dataclasses.replace``, of an object with slots all of whose fields are given to its initializer.

    It takes half of the time: for what a watch replaces for each host in each cycle.
    """
    kind: Any = type(value)
    read, setters, finish = _make_copier(kind)
    made: T = object.__new__(kind)
    for set_value, each in zip(setters.values(), read(value), strict=False):
        set_value(made, each)
    if not changes.keys() <= setters.keys():
        _raise_mismatch(kind, changes)
    for name, each in changes.items():
        setters[name](made, each)
    if finish is not None:
        finish(made)
    return made


def _make_class(
    cls: type[T], *, frozen: bool = False, kw_only: bool = False, eq: bool = True, slots: bool = True
) -> type[T]:
    cls.__doc__ = cls.__doc__ or cls.__name__  # the standard one would write a signature
    made = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only)(cls)
    methods = _defer_methods(made, frozen=frozen)
    if eq:
        methods |= _defer_comparison(made, frozen=frozen)
    if frozen:
        methods |= _FROZEN_METHODS
    for name, method in methods.items():
        if name not in made.__dict__:
            setattr(made, name, method)
    return made


def _defer_methods(cls: type[Any], *, frozen: bool) -> dict[str, Method | None]:
    """Initializer and representation, each of which is made and replaced by its first call."""

    def __init__(self: Any, /, *given: Any, **values: Any) -> None:  # noqa: ANN401, N807
        _replace(cls, "__init__", _choose_init(cls)(cls, frozen=frozen))(self, *given, **values)

    def __repr__(self: Any) -> str:  # noqa: ANN401, N807
        return str(_replace(cls, "__repr__", _make_repr(cls))(self))

    return {"__init__": __init__, "__repr__": __repr__}


def _defer_comparison(cls: type[Any], *, frozen: bool) -> dict[str, Method | None]:
    def __eq__(self: object, other: object) -> Any:  # noqa: ANN401, N807
        return _replace(cls, "__eq__", _make_equality(cls))(self, other)

    def __hash__(self: object) -> int:  # noqa: N807
        return int(_replace(cls, "__hash__", _make_hash(cls))(self))

    return {"__eq__": __eq__, "__hash__": __hash__ if frozen else None}


def _replace(cls: type[Any], name: str, method: Method) -> Method:
    setattr(cls, name, method)
    return method


def _choose_init(cls: type[Any]) -> Method:
    if not all(each.init for each in fields(cls)):
        return _compile_init
    return _make_init if all(each.kw_only for each in fields(cls)) else _make_positional_init


def _make_positional_init(cls: type[Any], *, frozen: bool) -> Method:
    names = [each.name for each in fields(cls) if not each.kw_only]
    init = _make_init(cls, frozen=frozen)

    def __init__(self: Any, /, *given: Any, **values: Any) -> None:  # noqa: ANN401, N807
        if given:
            first = names[: len(given)]
            if len(given) > len(names):
                raise TypeError(f"{cls.__qualname__}.__init__() takes {len(names)} arguments")
            if not values.keys().isdisjoint(first):
                raise TypeError(f"{cls.__qualname__}.__init__() got multiple values for an argument")
            values.update(zip(first, given, strict=True))
        init(self, **values)

    return __init__


def _make_init(cls: type[Any], *, frozen: bool) -> Method:
    setters = [(each.name, getattr(cls, each.name).__set__) for each in fields(cls)]
    defaults = {each.name: each.default for each in fields(cls) if each.default is not MISSING}
    factories = [
        (each.name, each.default_factory) for each in fields(cls) if each.default_factory is not MISSING
    ]
    count, made = len(setters), 0
    finishes = hasattr(cls, "__post_init__")

    def __init__(self: Any, /, **values: Any) -> None:  # noqa: ANN401, N807
        nonlocal made
        made += 1
        if made == COMPILE_AFTER:
            cls.__init__ = _compile_init(cls, frozen=frozen)
        if len(values) != count:
            values = defaults | values
            for name, make in factories:
                if name not in values:
                    values[name] = make()
            if len(values) != count:
                _raise_mismatch(cls, values)
        try:
            for name, set_value in setters:
                set_value(self, values[name])
        except KeyError:
            _raise_mismatch(cls, values)
        if finishes:
            self.__post_init__()

    return __init__


def _compile_init(cls: type[Any], *, frozen: bool) -> Method:
    """The initializer that the standard library compiles for the same fields."""
    members: dict[str, Any] = {"__annotations__": {each.name: object for each in fields(cls)}}
    for each in fields(cls):
        options: dict[str, Any] = {"init": each.init, "kw_only": each.kw_only}
        if each.default is not MISSING:
            options["default"] = each.default
        elif each.default_factory is not MISSING:
            options["default_factory"] = each.default_factory
        members[each.name] = dataclasses.field(**options)
    if hasattr(cls, "__post_init__"):
        members["__post_init__"] = cls.__post_init__
    plain = type(cls.__name__, (), members)
    made: Method = vars(dataclasses.dataclass(frozen=frozen, repr=False, eq=False)(plain))["__init__"]
    made.__qualname__ = f"{cls.__qualname__}.__init__"
    return made


def _raise_mismatch(cls: type[Any], values: dict[str, Any]) -> NoReturn:
    names = [each.name for each in fields(cls)]
    unknown = [name for name in values if name not in names]
    if unknown:
        raise TypeError(f"{cls.__qualname__}.__init__() got an unexpected keyword argument {unknown[0]!r}")
    missing = ", ".join(repr(name) for name in names if name not in values)
    raise TypeError(f"{cls.__qualname__}.__init__() is missing required keyword-only arguments: {missing}")


def _make_repr(cls: type[Any]) -> Method:
    names = [each.name for each in fields(cls) if each.repr]

    @recursive_repr()
    def __repr__(self: Any) -> str:  # noqa: ANN401, N807
        values = ", ".join(f"{name}={getattr(self, name)!r}" for name in names)
        return f"{type(self).__qualname__}({values})"

    return __repr__


def _make_getter(cls: type[Any]) -> Method:
    names = [each.name for each in fields(cls) if each.compare]
    # Of one name attrgetter makes no tuple, and tuples compare the same object as equal, whatever it is.
    return attrgetter(*names, *names[-1:]) if names else lambda _: ()


def _make_equality(cls: type[Any]) -> Method:
    get_values = _make_getter(cls)

    def __eq__(self: object, other: object) -> Any:  # noqa: ANN401, N807
        return get_values(self) == get_values(other) if type(other) is type(self) else NotImplemented

    return __eq__


def _make_hash(cls: type[Any]) -> Method:
    get_values = _make_getter(cls)

    def __hash__(self: object) -> int:  # noqa: N807
        return hash(get_values(self))

    return __hash__


def _refuse_assignment(_self: object, name: str, _value: object) -> NoReturn:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deletion(_self: object, name: str) -> NoReturn:
    raise FrozenInstanceError(f"cannot delete field {name!r}")


def _get_state(self: Any) -> list[Any]:  # noqa: ANN401
    return [getattr(self, each.name) for each in fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:  # noqa: ANN401
    for each, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, each.name, value)


_FROZEN_METHODS: dict[str, Method | None] = {
    "__setattr__": _refuse_assignment,
    "__delattr__": _refuse_deletion,
    "__getstate__": _get_state,
    "__setstate__": _set_state,
}
