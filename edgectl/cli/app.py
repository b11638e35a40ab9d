"""The command: names in help groups. Only the command that is wanted is imported and has its options built."""

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup

from edgectl import __version__


class CommandEntry(NamedTuple):
    """Where a command stands (``module`` below edgectl), its help group and its one-line help."""

    module: str
    group: str
    help: str


# A name of two words is a command of the group that its first word names.
COMMANDS = {
    "probe": CommandEntry("cli.probe", "Schedule", "Measure every host and link."),
    "plan": CommandEntry(
        "cli.plan", "Schedule", "Rank the hosts for every task and show what would be done, and why."
    ),
    "apply": CommandEntry("cli.apply", "Schedule", "Make reality match: start, stop and move tasks."),
    "watch": CommandEntry("cli.watch", "Schedule", "Look, plan and, where allowed, apply again and again."),
    "status": CommandEntry("cli.status", "Inspect", "Show what runs where, since when, and what it uses."),
    "describe edge": CommandEntry("cli.describe", "Inspect", "Say everything that is known of an edge."),
    "describe robot": CommandEntry("cli.describe", "Inspect", "Say everything that is known of a robot."),
    "describe task": CommandEntry("cli.describe", "Inspect", "Say everything that is known of a task."),
    "top hosts": CommandEntry("cli.top", "Inspect", "Show how much each host uses, now and lately."),
    "top tasks": CommandEntry(
        "cli.top", "Inspect", "Show how much each task uses against its demand, now and lately."
    ),
    "get": CommandEntry("cli.get", "Inspect", "List edges, robots, tasks or links; with -w, what changes."),
    "logs": CommandEntry("cli.status", "Inspect", "Print the log of a task."),
    "explain": CommandEntry(
        "cli.explain", "Inspect", "Say why a task goes where it goes, and what would change that."
    ),
    "graph": CommandEntry("cli.graph", "Inspect", "Draw tasks, what they need and where the plan puts them."),
    "events": CommandEntry(
        "cli.events", "Inspect", "Say what happened: hosts lost and back, tasks started, moved, failed."
    ),
    "replay": CommandEntry(
        "experiments.commands.replay",
        "Evidence",
        "Decide what was recorded again, under other rules, side by side.",
    ),
    "simulate": CommandEntry(
        "experiments.commands.simulate",
        "Evidence",
        "Run a mission in a model, under several schemes, several times.",
    ),
    "experiment run": CommandEntry(
        "experiments.commands.experiment",
        "Evidence",
        "Run a mission on the real hosts, under several schemes, several times.",
    ),
    "experiment show": CommandEntry(
        "experiments.commands.experiment", "Evidence", "Compare what an experiment has measured so far."
    ),
    "report": CommandEntry(
        "experiments.commands.report",
        "Evidence",
        "Write a run of an experiment as a page with its table and figures.",
    ),
    "ssim": CommandEntry(
        "experiments.commands.ssim", "Evidence", "Say how like the truth a map is that a robot has made."
    ),
    "profile": CommandEntry(
        "cli.profile", "Inspect", "Show what a task was measured to use; put it into its file."
    ),
    "history": CommandEntry(
        "cli.history", "Inspect", "List what was done to the fleet, by whom and how it ended."
    ),
    "show": CommandEntry("cli.history", "Inspect", "Print one revision of the history, or a saved plan."),
    "rollback": CommandEntry(
        "cli.history", "Fleet", "Go back to where the tasks stood after an earlier revision."
    ),
    "stop": CommandEntry("cli.stop", "Fleet", "Stop tasks."),
    "restart": CommandEntry("cli.stop", "Fleet", "Stop a task and start it again where it runs."),
    "doctor": CommandEntry(
        "cli.doctor", "Fleet", "Find what is wrong with hosts and links, and what mends it."
    ),
    "profilers start": CommandEntry(
        "cli.profilers", "Fleet", "Start a small process on each host that measures all the time."
    ),
    "profilers status": CommandEntry(
        "cli.profilers", "Fleet", "Show which profilers run and what they cost."
    ),
    "profilers stop": CommandEntry("cli.profilers", "Fleet", "Stop the profilers."),
    "trust": CommandEntry("cli.operator_marks", "Fleet", "Show a host's key and, after a yes, remember it."),
    "cordon": CommandEntry("cli.operator_marks", "Fleet", "Close hosts to new tasks."),
    "drain": CommandEntry("cli.drain", "Fleet", "Close hosts and move their tasks away now."),
    "uncordon": CommandEntry("cli.operator_marks", "Fleet", "Open cordoned hosts again."),
    "fence": CommandEntry(
        "cli.operator_marks", "Fleet", "Say that a host is off, so that its tasks may start elsewhere."
    ),
    "unfence": CommandEntry("cli.operator_marks", "Fleet", "Take back that hosts are switched off."),
    "done": CommandEntry(
        "cli.operator_marks", "Fleet", "Say that tasks have completed; they are stopped by the next apply."
    ),
    "reopen": CommandEntry("cli.operator_marks", "Fleet", "Let completed tasks be scheduled again."),
    "init": CommandEntry(
        "cli.offline_commands", "Files", "Write a small fleet that plans and applies at once."
    ),
    "validate": CommandEntry(
        "cli.offline_commands", "Files", "Check the inventory and the task files without touching a host."
    ),
    "export prometheus": CommandEntry(
        "cli.export", "Files", "Say what was measured and decided as Prometheus metrics."
    ),
    "export csv": CommandEntry("cli.export", "Files", "Write the history as CSV."),
    "export jsonl": CommandEntry("cli.export", "Files", "Write the history as JSON Lines."),
    "export cron": CommandEntry(
        "cli.export_jobs", "Files", "Write the crontab line that applies again and again."
    ),
    "export systemd": CommandEntry(
        "cli.export_jobs", "Files", "Write the systemd units that apply again and again, or watch."
    ),
    "version": CommandEntry("cli.offline_commands", "Settings", "Print the version."),
    "completion": CommandEntry("cli.offline_commands", "Settings", "Print the completion script of a shell."),
}
# First word of such names -> one line of help.
GROUP_HELP: dict[str, str] = {
    "describe": "Say everything that is known of one edge, robot or task.",
    "top": "Show who uses how much; with -w live, with -i full screen.",
    "profilers": "Let hosts measure all the time, so that a probe need not wait.",
    "export": "Write for other programs.",
    "experiment": "Compare schemes on the real hosts.",
}
SUMMARY = "Place robot tasks on edge computers by measured utility: probe, plan, apply, over SSH."
EPILOG = (
    "Exit codes: 0 done; 1 failed; 2 changes pending, 3 unplaced (plan --detailed-exitcode); 4 partly done; 64 usage; "
    "75 locked, stale or busy, try again; 130 interrupted.\n\n"
    "Environment: EDGECTL_INVENTORY, EDGECTL_TASKS, EDGECTL_OUTPUT, EDGECTL_STATE_DIR, EDGECTL_DEBUG, NO_COLOR, FORCE_COLOR."
)
CONTEXT_SETTINGS: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class SectionedHelpGroup(TyperGroup):
    """Help with the commands in their groups; and examples, which keep their lines."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401, ARG002
        """Write one section per group, in the order of ``COMMANDS``."""
        for group in dict.fromkeys(entry.group for entry in COMMANDS.values()):
            names = dict.fromkeys(name.split()[0] for name, entry in COMMANDS.items() if entry.group == group)
            with formatter.section(group):
                formatter.write_dl(
                    [
                        (name, GROUP_HELP[name] if name in GROUP_HELP else COMMANDS[name].help)
                        for name in names
                    ]
                )


def build_app(words: Sequence[str]) -> typer.Typer:
    """The application for this command line: all names, but only the wanted command with its options."""
    completing = "_EDGECTL_COMPLETE" in os.environ
    named = [word for word in words if not word.startswith("-")]
    wanted = " ".join(named[: 2 if named and named[0] in GROUP_HELP else 1])
    return build_app_with_commands(list(COMMANDS) if completing else [wanted], completing=completing)


def build_app_with_commands(wanted: Sequence[str], *, completing: bool = False) -> typer.Typer:
    """The application with the options of the ``wanted`` commands."""
    app = typer.Typer(
        cls=SectionedHelpGroup, add_completion=completing, rich_markup_mode=None, context_settings=CONTEXT_SETTINGS, epilog=EPILOG, no_args_is_help=False,
        pretty_exceptions_enable=False,
    )  # fmt: skip
    app.callback(help=SUMMARY)(_root_callback)
    groups = {name: _add_command_group(app, name, text) for name, text in GROUP_HELP.items()}
    for name, entry in COMMANDS.items():
        first, _, second = name.partition(" ")
        place = groups.get(first, app)
        if name in wanted:
            function = getattr(import_module(f"edgectl.{entry.module}"), f"{name.replace(' ', '_')}_command")
            text, examples = split_docstring(function)
            place.command(
                second or name,
                help=text,
                epilog=f"\b\nExamples:\n{examples}",
                context_settings=CONTEXT_SETTINGS,
            )(function)
        else:
            place.command(second or name, help=entry.help)(_placeholder_command)
    return app


def _add_command_group(app: typer.Typer, name: str, text: str) -> typer.Typer:
    """A place for the commands whose names begin with ``name``; alone it shows what there is."""
    group = typer.Typer(rich_markup_mode=None, context_settings=CONTEXT_SETTINGS, no_args_is_help=True)
    app.add_typer(group, name=name, help=text)
    return group


def _print_version(wanted: bool) -> None:  # noqa: FBT001 - as typer calls it
    if wanted:
        typer.echo(f"edgectl {__version__}")
        raise typer.Exit


def _root_callback(
    *,
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """What stands before every command."""


def _placeholder_command() -> None:
    """Stand where a command stands that nobody asked for."""


def split_docstring(function: Callable[..., object]) -> tuple[str, str]:
    """The docstring of a command: what it does, and its examples, one per line."""
    text, _, examples = (function.__doc__ or "").partition("Examples:")
    return text.strip(), "\n".join(f"  {line.strip()}" for line in examples.strip().splitlines())
