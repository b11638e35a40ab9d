# SPDX-License-Identifier: Apache-2.0
"""Substitutions of ROS 1 launch files; ``$(eval ..)`` without Python's eval."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from edgectl.config.problems import Mark, ProblemCode
from edgectl.importers.expression import ExpressionError, evaluate_expression
from edgectl.importers.fault import ImportFaultError
from edgectl.importers.launch_values import Launch, Workspace, mark_directory, mark_package
from edgectl.importers.substitution import SubstitutionFunction, substitute
from edgectl.names import format_name_list, suggest_name

_EVAL = "$(eval "


def substitute_ros1(
    text: str, mark: Mark, arguments: Mapping[str, str], file: str, workspace: Workspace, launch: Launch
) -> str:
    """``text`` with its substitutions replaced; ``$(find P)`` becomes the mark of the package.

    Raises:
        ImportFaultError: one of them is unknown or has no value.
    """
    functions = _build_functions(arguments, file, workspace, launch)
    if text.startswith(_EVAL) and text.endswith(")"):
        return _evaluate(text[len(_EVAL) : -1], mark, arguments, functions)
    return substitute(text, functions, mark)


def _build_functions(
    arguments: Mapping[str, str], file: str, workspace: Workspace, launch: Launch
) -> dict[str, SubstitutionFunction]:
    get_environment = partial(_get_environment, workspace, launch)
    return {
        "arg": partial(_get_argument, arguments),
        "env": get_environment,
        "optenv": partial(_get_optional_environment, workspace, get_environment),
        "find": lambda words, mark: mark_package(_get_one_word("find", words, mark), mark),
        "anon": partial(_make_name, launch),
        "dirname": lambda _words, _mark: mark_directory(file, workspace),
        "eval": _refuse_inner_eval,
    }


def _get_argument(arguments: Mapping[str, str], words: Sequence[str], mark: Mark) -> str:
    name = _get_one_word("arg", words, mark)
    if name in arguments:
        return arguments[name]
    match = suggest_name(name, arguments)
    known = f"the args are {format_name_list(list(arguments))}" if arguments else "declare it before"
    hint = f"did you mean {match}?" if match else known
    raise ImportFaultError(mark, ProblemCode.UNKNOWN_NAME, f"unknown arg {name}", hint)


def _get_environment(workspace: Workspace, launch: Launch, words: Sequence[str], mark: Mark) -> str:
    name = _get_one_word("env", words, mark)
    if name not in workspace.env:
        hint = f"export {name}, or write $(optenv {name} DEFAULT)"
        message = f"the environment variable {name} is not set"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, hint)
    launch.note(mark, f"$(env {name}) is taken from this machine: it is fixed in the task")
    return workspace.env[name]


def _get_optional_environment(
    workspace: Workspace, get_environment: SubstitutionFunction, words: Sequence[str], mark: Mark
) -> str:
    if not words:
        message = "$(optenv) needs a name"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, "write $(optenv NAME DEFAULT)")
    return get_environment(words[:1], mark) if words[0] in workspace.env else " ".join(words[1:])


def _make_name(launch: Launch, words: Sequence[str], mark: Mark) -> str:
    name = _get_one_word("anon", words, mark)
    launch.note(mark, f"$(anon {name}) is {name}_1: a task keeps its name")
    return f"{name}_1"


def _refuse_inner_eval(_words: Sequence[str], mark: Mark) -> str:
    message = "$(eval ..) must be the whole value"
    raise ImportFaultError(
        mark, ProblemCode.SUBSTITUTION, message, "put all of the value into the expression"
    )


def _get_one_word(name: str, words: Sequence[str], mark: Mark) -> str:
    if len(words) != 1:
        message = f"$({name}) takes one word, not {len(words)}"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, f"write $({name} NAME)")
    return words[0]


def _evaluate(
    text: str, mark: Mark, arguments: Mapping[str, str], functions: Mapping[str, SubstitutionFunction]
) -> str:
    def as_function(name: str) -> Callable[..., Any]:
        def call(*words: object) -> object:
            text = functions[name]([str(word) for word in words], mark)
            return infer_value(text) if name == "arg" else text

        return call

    names = {name: infer_value(value) for name, value in arguments.items()}
    callables = {name: as_function(name) for name in functions if name != "eval"}
    try:
        value = evaluate_expression(text, names, callables)
    except ExpressionError as error:
        raise ImportFaultError(
            mark,
            ProblemCode.SUBSTITUTION,
            f"the expression {error}",
            "simplify it, or give the value as an arg",
        ) from error
    return str(value)


def infer_value(text: str) -> str | int | float | bool:
    """The value of a text by the rule of roslaunch: float if it has a point, int, bool, else text."""
    try:
        if "." in text:
            return float(text)
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    return text.lower() == "true" if text.lower() in ("true", "false") else text
