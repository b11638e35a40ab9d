# SPDX-License-Identifier: Apache-2.0
"""Recording stand-in of launch and launch_ros: notes the processes that a description would start.

It runs in a child process, in which the directory of this module is first on sys.path.
"""

import os
import re
import runpy
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any

MAX_ACTIONS = 20_000
MAX_FILES = 200
MAX_DEPTH = 30
_TRUE, _FALSE = {"true", "1", "yes", "on"}, {"false", "0", "no", "off"}


class LaunchError(Exception):
    """The description cannot be evaluated. ``place``: file and line of the cause."""

    def __init__(self, message: str, place: tuple[str, int] = ("", 0), hint: str = "") -> None:
        super().__init__(message)
        self.message, self.place, self.hint = message, place, hint


def find_place() -> tuple[str, int]:
    """File and line of the innermost caller that is no part of the stand-in."""
    frame = sys._getframe(1)  # noqa: SLF001 - there is no other way to a line number that costs as little
    here = os.path.dirname(__file__)  # noqa: PTH120 - called for each object of the file
    while frame is not None and frame.f_back is not None:
        if not frame.f_code.co_filename.startswith((here, "<")):
            return frame.f_code.co_filename, frame.f_lineno
        frame = frame.f_back
    return "", 0


class Recorded:
    """Base of everything that a file constructs: its arguments and its place."""

    def __init__(self, *words: Any, **named: Any) -> None:  # noqa: ANN401
        self.words, self.named = words, named
        self.place = find_place()
        self.condition = named.get("condition")

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        if name.startswith("__"):
            raise AttributeError(name)
        raise LaunchError(f"{type(self).__name__}.{name} is not supported", find_place())


class Substitution(Recorded):
    """Something whose text is known once the arguments are."""

    def perform(self, context: "Context") -> str:  # noqa: ARG002
        """Its text.

        Raises:
            LaunchError: it has none here.
        """
        raise LaunchError(f"{type(self).__name__} has no value here", self.place)


class Context:
    """State of the evaluation."""

    def __init__(self, given: Mapping[str, str], packages: Mapping[str, str], *, runs_exposed: bool) -> None:
        self.launch_configurations: dict[str, str] = dict(given)
        self.packages = packages
        self.runs_exposed = runs_exposed
        self.namespace = "/"
        self.env: dict[str, str] = {}
        self.remaps: list[list[str]] = []
        self.parameters: dict[str, Any] = {}
        self.declared: list[str] = []
        self.processes: list[dict[str, Any]] = []
        self.visited: list[Any] = []  # kept, so that no id is used again
        self.notes: list[dict[str, Any]] = []
        self.orders: dict[int, list[int]] = {}
        self.event_needs: list[tuple[int, str]] = []
        self.handlers: list[tuple[Any, str, Any, tuple[str, int]]] = []
        self.files: list[str] = []
        self.count = self.loaded = 0
        self.place: tuple[str, int] = ("", 0)  # of the action that was visited last

    @property
    def environment(self) -> Mapping[str, str]:
        return {**os.environ, **self.env}

    def perform_substitution(self, value: Any) -> str:  # noqa: ANN401
        return perform(self, value)

    def add(self, process: dict[str, Any], place: tuple[str, int]) -> list[int]:
        """Note one process; its number."""
        needs = [list(each) for each in self.event_needs]
        self.processes.append({**process, "place": list(place), "needs": needs})
        return [len(self.processes) - 1]

    def note(self, place: tuple[str, int], message: str, hint: str = "") -> None:
        self.notes.append({"file": place[0], "line": place[1], "message": message, "hint": hint})


def perform(context: Context, value: Any) -> str:  # noqa: ANN401
    """The text of a value: a text, a substitution, or a list of them."""
    if isinstance(value, Substitution):
        return value.perform(context)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str | int | float | os.PathLike):
        return str(value)
    if isinstance(value, Iterable):
        return "".join(perform(context, each) for each in value)
    raise LaunchError(f"{type(value).__name__} is not a text", find_place())


def perform_boolean(context: Context, value: Any, place: tuple[str, int]) -> bool:  # noqa: ANN401
    text = perform(context, value).strip().lower()
    if text not in _TRUE | _FALSE:
        raise LaunchError(f"{text!r} is neither true nor false", place)
    return text in _TRUE


def perform_value(context: Context, value: Any) -> Any:  # noqa: ANN401
    """The value of a parameter; the texts of substitutions in it get the type that YAML gives them."""
    if isinstance(value, Substitution):
        typed = getattr(type(value), "perform_typed", None)
        return typed(value, context) if typed is not None else parse_scalar(value.perform(context))
    if isinstance(value, Mapping):
        return {perform(context, key): perform_value(context, each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        if (
            value
            and all(isinstance(each, Substitution | str) for each in value)
            and any(isinstance(each, Substitution) for each in value)
        ):
            return parse_scalar(perform(context, value))
        return [perform_value(context, each) for each in value]
    return value if isinstance(value, bool | int | float | str) or value is None else str(value)


def parse_scalar(text: str) -> Any:  # noqa: ANN401
    """A text with the type that YAML gives it."""
    if text.strip().lower() in ("true", "false"):
        return text.strip().lower() == "true"
    for kind, pattern in (
        (int, r"[-+]?[0-9]+"),
        (float, r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)([eE][-+]?[0-9]+)?"),
    ):
        if re.fullmatch(pattern, text.strip()):
            return kind(text)
    return text


def get_package_directory(package: str, kind: str) -> str:
    """The directory of a package: the one here, else a mark that the host replaces."""
    directory = CONTEXT.packages.get(package) if CONTEXT is not None else None
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", package):
        raise LaunchError(f"{package!r} is no name of a package", find_place())
    return directory if directory and kind == "share" else f"\ue000{kind}:{package}\ue001"


CONTEXT: Context | None = None


def visit(context: Context, action: Any) -> list[int]:  # noqa: ANN401
    """Evaluate one action; the numbers of the processes that it starts."""
    context.count += 1
    context.visited.append(action)
    if context.count > MAX_ACTIONS:
        raise LaunchError(f"more than {MAX_ACTIONS:,} actions", find_place())
    if action is None:
        return []
    if isinstance(action, list | tuple):
        return [number for each in action for number in visit(context, each)]
    if not isinstance(action, Recorded):
        raise LaunchError(f"{type(action).__name__} is not an action", context.place)
    context.place = action.place
    condition = action.condition
    if condition is not None and not condition.evaluate(context):
        return []
    handler: Callable[[Context], list[int]] | None = getattr(type(action), "execute", None)
    if handler is None:
        context.note(action.place, f"{type(action).__name__} is not imported")
        return []
    numbers: list[int] = action.execute(context)
    context.orders.setdefault(id(action), []).extend(numbers)
    return numbers


def join_namespace(namespace: str, name: str) -> str:
    """``name`` in ``namespace``; one that begins with / is global."""
    parts = [name.strip("/")] if name.startswith("/") else [namespace.strip("/"), name.strip("/")]
    return "/" + "/".join(part for part in parts if part)


def load_description(context: Context, path: str, place: tuple[str, int]) -> Any:  # noqa: ANN401
    """Run a launch file and call its generate_launch_description.

    Raises:
        LaunchError: it is not here, has no such function, or includes itself for ever.
    """
    if "\ue000" in path:
        package = path.partition(":")[2].partition("\ue001")[0]
        hint = "name the directory of its workspace: --package-path DIR"
        raise LaunchError(f"the package {package} is not on this machine", place, hint)
    if os.path.isfile(path) and os.stat(path).st_mode & 0o002 and not context.runs_exposed:  # noqa: PTH113, PTH116
        raise LaunchError(f"every user may change {path}, so it is not run", place, f"chmod go-w {path}")
    context.loaded += 1
    if len(context.files) >= MAX_DEPTH or context.loaded > MAX_FILES:
        raise LaunchError("too many includes, or a file that includes itself", place)
    try:
        names = runpy.run_path(path)
    except FileNotFoundError as error:
        raise LaunchError(f"no such file: {error.filename}", place, "correct the path") from error
    generate = names.get("generate_launch_description")
    if not callable(generate):
        raise LaunchError(
            "the file has no function generate_launch_description", (path, 1), "name a launch file"
        )
    context.files.append(path)
    return generate()


def evaluate(description: Any, context: Context) -> None:  # noqa: ANN401
    """Visit everything, then what event handlers start."""
    visit(context, description)
    done = 0
    while done < len(context.handlers):
        target, state, actions, place = context.handlers[done]
        done += 1
        numbers = context.orders.get(id(target), [])
        if not numbers:
            context.note(
                place,
                "the target of this event handler starts no process: its actions are imported without needs",
            )
        before = context.event_needs
        context.event_needs = [(number, state) for number in numbers]
        visit(context, actions)
        context.event_needs = before


def make_dropped(name: str) -> type[Recorded]:
    """A class for an action or a substitution that has no counterpart in a task."""
    if name.startswith("_") or not name[:1].isupper():
        raise AttributeError(name)
    return type(name, (Substitution,), {})
