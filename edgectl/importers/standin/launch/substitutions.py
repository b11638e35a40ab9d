# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch.substitutions."""

import os
from typing import Any

from _edgectl_recorder import (
    Context,
    LaunchError,
    Recorded,
    Substitution,
    find_place,
    make_dropped,
    perform,
    perform_boolean,
)


class TextSubstitution(Substitution):
    """A text."""

    def perform(self, context: Context) -> str:
        """The text."""
        return perform(context, self.named.get("text", self.words[0] if self.words else ""))


class LaunchConfiguration(Substitution):
    """The value of an argument."""

    def __init__(self, variable_name: Any, *, default: Any = None) -> None:  # noqa: ANN401
        super().__init__()
        self.variable_name, self.default = variable_name, default

    def perform(self, context: Context) -> str:
        """The value.

        Raises:
            LaunchError: it has none.
        """
        name = perform(context, self.variable_name)
        if name in context.launch_configurations:
            return context.launch_configurations[name]
        if self.default is not None:
            return perform(context, self.default)
        raise LaunchError(
            f"unknown argument {name}", self.place, "declare it before, or give it: NAME:=VALUE"
        )


class PathJoinSubstitution(Substitution):
    """Parts of a path."""

    def perform(self, context: Context) -> str:
        """The path."""
        return os.path.join(*(perform(context, part) for part in self.words[0]))  # noqa: PTH118 - texts with marks


class EnvironmentVariable(Substitution):
    """A variable of the environment."""

    def perform(self, context: Context) -> str:
        """Its value here.

        Raises:
            LaunchError: it has none.
        """
        name = perform(context, self.words[0] if self.words else self.named["name"])
        if name in context.environment:
            context.note(
                self.place,
                f"the environment variable {name} is taken from this machine: it is fixed in the task",
            )
            return context.environment[name]
        default = self.named.get("default_value")
        if default is None:
            raise LaunchError(f"the environment variable {name} is not set", self.place, f"export {name}")
        return perform(context, default)


class ThisLaunchFileDir(Substitution):
    """The directory of the launch file."""

    def perform(self, context: Context) -> str:
        """Its path."""
        return os.path.dirname(context.files[-1])  # noqa: PTH120


class ThisLaunchFile(Substitution):
    """The launch file."""

    def perform(self, context: Context) -> str:
        """Its path."""
        return context.files[-1]


class AnonName(Substitution):
    """A name that would be unique."""

    def perform(self, context: Context) -> str:
        """The name with a number: a task keeps its name."""
        return perform(context, self.words[0] if self.words else self.named["name"]) + "_1"


class PythonExpression(Substitution):
    """An expression; it is of the language of the file itself, which runs already."""

    def perform(self, context: Context) -> str:
        """Its value, by the same small evaluator as that of XML."""
        from edgectl.importers.expression import ExpressionError, evaluate_expression

        text = perform(context, self.words[0] if self.words else self.named["expression"])
        try:
            return str(evaluate_expression(text, {}, {}))
        except ExpressionError as error:
            raise LaunchError(f"the expression {error}", self.place) from error


class _Logic(Substitution):
    def operands(self, context: Context) -> list[str]:
        return [perform(context, word) for word in (*self.words, *self.named.values())]

    def truths(self, context: Context) -> list[bool]:
        return [perform_boolean(context, word, self.place) for word in self.operands(context)]


class NotSubstitution(_Logic):
    """Not."""

    def perform(self, context: Context) -> str:
        """The truth value."""
        return str(not all(self.truths(context))).lower()


class AndSubstitution(_Logic):
    """And."""

    def perform(self, context: Context) -> str:
        """The truth value."""
        return str(all(self.truths(context))).lower()


class OrSubstitution(_Logic):
    """Or."""

    def perform(self, context: Context) -> str:
        """The truth value."""
        return str(any(self.truths(context))).lower()


class EqualsSubstitution(_Logic):
    """Equality."""

    def perform(self, context: Context) -> str:
        """The truth value."""
        return str(len(set(self.operands(context))) == 1).lower()


class NotEqualsSubstitution(_Logic):
    """Inequality."""

    def perform(self, context: Context) -> str:
        """The truth value."""
        return str(len(set(self.operands(context))) > 1).lower()


class IfElseSubstitution(_Logic):
    """One of two values."""

    def perform(self, context: Context) -> str:
        """The chosen one."""
        condition, *values = self.operands(context)
        return values[0] if perform_boolean(context, condition, self.place) else "".join(values[1:])


class Command(Substitution):
    """The output of a command, which is not run."""

    def perform(self, context: Context) -> str:
        """Refuse it."""
        words = perform(context, self.words[0] if self.words else self.named["command"])
        raise LaunchError(
            f"the command {words.split()[0]!r} is not run here", self.place, "import with --group file"
        )


def __getattr__(name: str) -> type[Recorded]:
    if name == "FindExecutable":
        raise LaunchError("FindExecutable has no value here", find_place(), "import with --group file")
    return make_dropped(name)
