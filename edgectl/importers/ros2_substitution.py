# SPDX-License-Identifier: Apache-2.0
"""Substitutions of ROS 2 launch files in XML and YAML, without running a program."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from edgectl.config.problems import Mark, ProblemCode
from edgectl.importers.expression import ExpressionError, evaluate_expression
from edgectl.importers.fault import ImportFaultError
from edgectl.importers.launch_values import Launch, Workspace, mark_directory, mark_package
from edgectl.importers.ros_parameters import parse_yaml_scalar
from edgectl.importers.substitution import SubstitutionFunction, substitute
from edgectl.names import format_name_list, suggest_name

_BOOLEANS = {
    "true": True,
    "1": True,
    "yes": True,
    "on": True,
    "false": False,
    "0": False,
    "no": False,
    "off": False,
}


def substitute_ros2(
    text: str,
    mark: Mark,
    arguments: Mapping[str, str],
    env: Mapping[str, str],
    file: str,
    workspace: Workspace,
    launch: Launch,
) -> str:
    """``text`` with its substitutions replaced; ``$(find-pkg-share P)`` becomes the mark of the package.

    Raises:
        ImportFaultError: one of them is unknown or has no value.
    """
    if "$(" not in text:
        return text
    functions: dict[str, SubstitutionFunction] = {
        "var": partial(_get_variable, arguments),
        "env": partial(_get_environment, env, workspace, launch),
        "eval": _evaluate,
        "anon": partial(_make_name, launch),
        "dirname": lambda _words, _mark: mark_directory(file, workspace),
        "find-pkg-share": lambda words, mark: mark_package(" ".join(words), mark),
        "find-pkg-prefix": lambda words, mark: mark_package(" ".join(words), mark, "prefix"),
        "exec-in-pkg": _refuse_program,
        "find-exec": _refuse_program,
        "command": _refuse_program,
        **_LOGIC,
    }
    return substitute(text, functions, mark)


def _get_variable(arguments: Mapping[str, str], words: Sequence[str], mark: Mark) -> str:
    name = words[0] if words else ""
    if name in arguments:
        return arguments[name]
    if len(words) > 1:
        return " ".join(words[1:])
    match = suggest_name(name, arguments)
    known = (
        f"known are {format_name_list(list(arguments))}" if arguments else "declare it before with arg or let"
    )
    hint = f"did you mean {match}?" if match else known
    raise ImportFaultError(mark, ProblemCode.UNKNOWN_NAME, f"unknown variable {name}", hint)


def _get_environment(
    env: Mapping[str, str], workspace: Workspace, launch: Launch, words: Sequence[str], mark: Mark
) -> str:
    name = words[0] if words else ""
    if name in env:
        return env[name]
    if name in workspace.env:
        launch.note(mark, f"$(env {name}) is taken from this machine: it is fixed in the task")
        return workspace.env[name]
    if len(words) > 1:
        return " ".join(words[1:])
    message = f"the environment variable {name} is not set"
    hint = f"export {name}, or write $(env {name} DEFAULT)"
    raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, hint)


def _evaluate(words: Sequence[str], mark: Mark) -> str:
    try:
        return str(evaluate_expression(" ".join(words), {}, {}))
    except ExpressionError as error:
        hint = "simplify it, or give the value as an arg"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, f"the expression {error}", hint) from error


def _make_name(launch: Launch, words: Sequence[str], mark: Mark) -> str:
    name = words[0] if words else "anonymous"
    launch.note(mark, f"$(anon {name}) is {name}_1: a task keeps its name")
    return f"{name}_1"


def _refuse_program(_words: Sequence[str], mark: Mark) -> str:
    message = "a substitution that runs or looks up a program has no value here"
    hint = "write the value, or import with --group file"
    raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, hint)


def read_boolean(text: str, name: str, mark: Mark) -> bool:
    """A truth value as launch files of ROS 2 write it.

    Raises:
        ImportFaultError: it is none.
    """
    value = text.strip().lower()
    if value not in _BOOLEANS:
        message = f"{name} must be true or false, not {value!r}"
        raise ImportFaultError(mark, ProblemCode.WORD, message, "write true or false")
    return _BOOLEANS[value]


def _read_operands(words: Sequence[str], mark: Mark) -> list[bool]:
    return [read_boolean(word, "an operand", mark) for word in words]


def _are_equal(words: Sequence[str], mark: Mark) -> bool:
    if len(words) != 2:
        message = f"takes two operands, not {len(words)}"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, "put a text with blanks in quotes")
    return parse_yaml_scalar(words[0]) == parse_yaml_scalar(words[1])


def _choose_value(words: Sequence[str], mark: Mark) -> str:
    if len(words) not in (2, 3):
        message = "if takes a condition and one or two values"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, "write $(if CONDITION A B)")
    return words[1] if read_boolean(words[0], "the condition", mark) else " ".join(words[2:])


def _as_text(test: Callable[[Sequence[str], Mark], bool]) -> SubstitutionFunction:
    return lambda words, mark: "true" if test(words, mark) else "false"


_LOGIC: dict[str, SubstitutionFunction] = {
    "not": _as_text(lambda words, mark: not all(_read_operands(words, mark))),
    "and": _as_text(lambda words, mark: all(_read_operands(words, mark))),
    "or": _as_text(lambda words, mark: any(_read_operands(words, mark))),
    "all": _as_text(lambda words, mark: all(_read_operands(words, mark))),
    "any": _as_text(lambda words, mark: any(_read_operands(words, mark))),
    "equals": _as_text(_are_equal),
    "not-equals": _as_text(lambda words, mark: not _are_equal(words, mark)),
    "if": _choose_value,
}
