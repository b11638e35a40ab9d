# SPDX-License-Identifier: Apache-2.0
"""Rules for elements of launch files that are the same in ROS 1 and ROS 2."""

import shlex
from collections.abc import Callable, Iterable

from edgectl.config.problems import ProblemCode, Problems
from edgectl.importers.elements import Element
from edgectl.importers.fault import ImportFaultError
from edgectl.names import suggest_name

# Attributes of any element that decide whether it counts.
CONDITIONS = ("if", "unless")


def check_root(root: Element, problems: Problems) -> bool:
    """Whether the file is a launch file; if it is not, that is collected."""
    if root.tag == "launch":
        return True
    message = f"the root element is {root.tag}, not launch"
    problems.add(root.mark, ProblemCode.ELEMENT, message, "name a launch file")
    return False


def build_unknown_element(element: Element, known: Iterable[str]) -> ImportFaultError:
    """The fault of an element that is none of ``known``."""
    message = f"unknown element {element.tag}"
    return ImportFaultError(element.mark, ProblemCode.ELEMENT, message, _suggest(element.tag, sorted(known)))


def check_attribute_names(element: Element, known: Iterable[str]) -> None:
    """Raise the fault of the first attribute that is none of ``known``."""
    names = tuple(known)
    for name, attribute in element.attributes.items():
        if name not in names:
            message = f"unknown attribute {name} of {element.tag}"
            raise ImportFaultError(attribute.mark, ProblemCode.ELEMENT, message, _suggest(name, names))


def are_conditions_met(element: Element, read_boolean: Callable[[str], bool | None]) -> bool:
    """Whether the conditions of an element hold. ``read_boolean``: one of them, None if not stated."""
    if all(name in element.attributes for name in CONDITIONS):
        message = "if and unless exclude each other"
        raise ImportFaultError(element.mark, ProblemCode.CONTRADICTION, message, "remove one of the two")
    unless = read_boolean("unless")
    return read_boolean("if") is not False and unless is not True


def split_words(element: Element, name: str, text: str) -> tuple[str, ...]:
    """The arguments of a program in ``text``, the value of the attribute ``name``, split as by a shell."""
    try:
        return tuple(shlex.split(text))
    except ValueError as error:
        mark = element.attributes[name].mark
        raise ImportFaultError(
            mark, ProblemCode.TEXT, f"a quote in {name} is not closed", "close it"
        ) from error


def _suggest(name: str, known: Iterable[str]) -> str:
    names = tuple(known)
    match = suggest_name(name, names)
    return f"did you mean {match}?" if match else f"known are {', '.join(names)}"
