"""config commands: the settings in effect, and the choice of a context."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.completion import complete_contexts
from edgectl.errors import EdgectlError, FileError, UsageError
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.cli.project import ChosenFiles, Settings
    from edgectl.config.project_file import SettingsFile
    from edgectl.views.config import Setting


def config_view_command(
    *,
    origin: Annotated[bool, Option("--origin", help="Also show where each value comes from.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
) -> None:
    """Show the settings in effect here: options, then environment, then edgectl.yaml, then the user's file.

    Examples:
        edgectl config view
        edgectl config view --origin
        edgectl config view -o json
    """
    from edgectl.cli.project import choose_context, choose_files, load_settings
    from edgectl.views.config import SettingsView

    settings = load_settings()
    missing = ""
    try:
        chosen: ChosenFiles | None = choose_files(inventory, tasks)
    except UsageError as error:
        chosen, missing = None, str(error)
    rows = list_settings(settings, chosen, choose_context(settings))
    console.print_view(SettingsView(rows, [missing] if missing else [], origin=origin), output)


def list_settings(
    settings: "Settings", chosen: "ChosenFiles | None", context: tuple[str, str]
) -> "list[Setting]":
    """The settings in effect, each with its origin."""
    from edgectl.cli.project import TASKS_DIRECTORY, find_default_place, find_place
    from edgectl.views.config import Setting

    project, user = settings.project, settings.user
    rows = [
        Setting(name="project", values=(str(project.path),) if project else ()),
        Setting(name="user", values=(str(user.path),) if user else ()),
        Setting(
            name="context",
            values=(context[0],) if context[0] else (),
            origin=context[1] if context[0] else "",
        ),
    ]
    if chosen is not None:
        tasks = tuple(map(str, chosen.tasks)) or (f"{chosen.folder / TASKS_DIRECTORY}/",)
        rows += [
            Setting(
                name="inventory",
                values=tuple(map(str, chosen.inventories)),
                origin=chosen.inventory_origin,
            ),
            Setting(name="tasks", values=tasks, origin=chosen.tasks_origin or "default"),
        ]
    rows += [
        Setting(name=f"defaults.{key}", values=(str(value),), origin=find_default_place(settings, key))
        for key, value in settings.defaults.items()
    ]
    if user is not None and user.safe_directories:
        safe = tuple(map(str, user.safe_directories))
        rows.append(
            Setting(name="safe_directories", values=safe, origin=find_place(user, "safe_directories"))
        )
    return rows


def config_get_contexts_command(*, output: options.NamedOutput = OutputFormat.TABLE) -> None:
    """List the contexts of edgectl.yaml and of the user; a star marks the one in effect.

    Examples:
        edgectl config get-contexts
        edgectl config get-contexts -o name
    """
    from edgectl.cli.project import choose_context, load_settings
    from edgectl.views.config import ContextRow, ContextsView

    settings = load_settings()
    current = choose_context(settings)[0]
    rows = [
        ContextRow(
            name=name,
            chosen=name == current,
            inventories=tuple(str(each.path) for each in context.inventory),
            tasks=tuple(str(each.path) for each in context.tasks),
            origin=f"{context.mark.source.file}:{context.mark.line}",
        )
        for name, context in settings.contexts.items()
    ]
    console.print_view(ContextsView(rows), output)


def config_current_context_command() -> None:
    """Print the name of the context in effect. Exit 1 if none is chosen.

    Examples:
        edgectl config current-context
    """
    from edgectl.cli.project import choose_context, load_settings

    name = choose_context(load_settings())[0]
    if not name:
        raise EdgectlError("no context is chosen", hint="list them: edgectl config get-contexts")
    console.print_text(f"{name}\n")


def config_use_context_command(
    name: Annotated[
        str,
        Argument(
            metavar="NAME",
            autocompletion=complete_contexts,
            help="A context of edgectl.yaml or of the user's configuration.",
            show_default=False,
        ),
    ],
) -> None:
    """Choose the context of later commands: written to edgectl.yaml if that chooses or names it, else to the
    user's configuration.

    Examples:
        edgectl config use-context demo
    """
    from edgectl.cli.project import CONTEXT_VARIABLE, choose_context, load_settings

    settings = load_settings()
    name = name.removeprefix("context/")
    check_known_names([name], settings.contexts, "context")
    file = _find_deciding_file(settings, name)
    _write_context(file, name)
    console.print_message(f"context/{name} chosen in {file.path}")
    _, origin = choose_context(settings)
    if origin == CONTEXT_VARIABLE:
        console.print_message(f"note: {CONTEXT_VARIABLE} is set and goes first")


def _find_deciding_file(settings: "Settings", name: str) -> "SettingsFile":
    """The file whose ``context`` is in effect after it is written."""
    project, user = settings.project, settings.user
    if project is not None and (project.context is not None or name in project.contexts or user is None):
        return project
    if user is None:  # a context comes from one of them
        raise EdgectlError("there is no settings file")
    return user


def _write_context(file: "SettingsFile", name: str) -> None:
    """Write ``context: NAME``, with all else in the file as it is."""
    from edgectl.cli.user_files import replace_file_text

    try:
        text = Path(file.path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise FileError(f"cannot read {file.path}: {error.strerror}") from error
    replace_file_text(file.path, text, _set_context(text, file, name))


def _set_context(text: str, file: "SettingsFile", name: str) -> str:
    """``text`` with the value of ``context`` replaced, or the key added after that of ``version``."""
    from edgectl.config.task_file_edit import parse_spans

    spans = parse_spans(text)
    stated = spans.entries.get("context")
    if stated is not None:
        return text[: stated.start] + name + text[stated.end :]
    if not spans.block:
        raise UsageError(f"{file.path} is written in one line", hint=f"add context: {name} to it")
    end = text.find("\n", spans.entries["version"].end)
    head, tail = (text, "") if end < 0 else (text[: end + 1], text[end + 1 :])
    return f"{head}{'' if head.endswith(chr(10)) else chr(10)}context: {name}\n{tail}"
