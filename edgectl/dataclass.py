"""``dataclass`` of the standard library, which compiles nothing for a frozen, slotted, keyword-only class.

The standard one compiles six methods per class, half a millisecond of CPU, which was half of the time of
importing edgectl. Those made here are closures over the fields; they behave alike and take as long (ADR 99).
Only the initializer of a class of which a process makes many objects is compiled after all (ADR 134).
"""

import dataclasses
from collections.abc import Callable
from dataclasses import MISSING, FrozenInstanceError, fields
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

T = TypeVar("T")
Method = Callable[..., Any]
# Objects of a class from which on a compiled initializer (0.2 ms to make, 1 us saved by each object) pays.
COMPILE_AFTER = 1000
_ABSENT = object()

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(**options: bool) -> Callable[[type[T]], type[T]]:
        """As the standard one; only ``frozen``, ``slots`` and ``kw_only`` together are made here."""
        made_here = options == {"frozen": True, "slots": True, "kw_only": True}
        return _make_class if made_here else dataclasses.dataclass(**options)


def _make_class(cls: type[T]) -> type[T]:
    cls.__doc__ = cls.__doc__ or cls.__name__  # the standard one would write a signature
    made = dataclasses.dataclass(init=False, repr=False, eq=False, slots=True, kw_only=True)(cls)
    methods = {
        "__init__": _make_init(made),
        "__repr__": _make_repr(made),
        **_make_comparison(made),
        "__setattr__": _refuse_assignment,
        "__delattr__": _refuse_deletion,
        "__getstate__": _get_state,
        "__setstate__": _set_state,
    }
    for name, method in methods.items():
        if name not in made.__dict__:
            setattr(made, name, method)
    return made


def _make_init(cls: type[Any]) -> Method:
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
            cls.__init__ = _compile_init(cls)
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


def _compile_init(cls: type[Any]) -> Method:
    """The same initializer as one function of the fields."""
    known: dict[str, Any] = {"_ABSENT": _ABSENT}
    parameters, lines = [], []
    for index, each in enumerate(fields(cls)):
        known[f"_set{index}"] = getattr(cls, each.name).__set__
        value = each.name
        if each.default is not MISSING:
            known[f"_default{index}"] = each.default
            parameters.append(f"{each.name}=_default{index}")
        elif each.default_factory is not MISSING:
            known[f"_make{index}"] = each.default_factory
            parameters.append(f"{each.name}=_ABSENT")
            value = f"_make{index}() if {each.name} is _ABSENT else {each.name}"
        else:
            parameters.append(each.name)
        lines.append(f"    _set{index}(self, {value})\n")
    if hasattr(cls, "__post_init__"):
        lines.append("    self.__post_init__()\n")
    head = f"def __init__(self, /{''.join(', ' + each for each in ['*', *parameters] if parameters)}):\n"
    exec(head + "".join(lines or ["    pass\n"]), known)  # noqa: S102 - names of fields, from our own classes
    made: Method = known["__init__"]
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


def _make_comparison(cls: type[Any]) -> dict[str, Method]:
    names = [each.name for each in fields(cls) if each.compare]
    # Of one name attrgetter makes no tuple, and tuples compare the same object as equal, whatever it is.
    get_values: Method = attrgetter(*names, *names[-1:]) if names else lambda _: ()

    def __eq__(self: object, other: object) -> Any:  # noqa: ANN401, N807
        return get_values(self) == get_values(other) if type(other) is type(self) else NotImplemented

    def __hash__(self: object) -> int:  # noqa: N807
        return hash(get_values(self))

    return {"__eq__": __eq__, "__hash__": __hash__}


def _refuse_assignment(_self: object, name: str, _value: object) -> NoReturn:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deletion(_self: object, name: str) -> NoReturn:
    raise FrozenInstanceError(f"cannot delete field {name!r}")


def _get_state(self: Any) -> list[Any]:  # noqa: ANN401
    return [getattr(self, each.name) for each in fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:  # noqa: ANN401
    for each, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, each.name, value)
