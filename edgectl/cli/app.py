# SPDX-License-Identifier: Apache-2.0
"""The typer application: commands in help groups; only the requested command is imported."""

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated, Any, Literal, NamedTuple

import typer
from typer.core import TyperGroup

from edgectl import __version__


class CommandEntry(NamedTuple):
    """Module of a command (below edgectl), its help group and its one-line help."""

    module: str
    group: str
    help: str


# A name of two words is a command of the group named by its first word.
COMMANDS = {
    "probe": CommandEntry("cli.probe", "Schedule", "Measure hosts, links and tasks."),
    "plan": CommandEntry(
        "cli.plan", "Schedule", "Rank hosts for each task and show the changes, with reasons."
    ),
    "diff": CommandEntry(
        "cli.diff", "Schedule", "Show what apply would change; exit 1 if there are changes."
    ),
    "apply": CommandEntry("cli.apply", "Schedule", "Start, stop and move tasks to match the plan."),
    "watch": CommandEntry("cli.watch", "Schedule", "Re-plan periodically; with --apply, also apply."),
    "status": CommandEntry("cli.status", "Inspect", "Show where tasks run and what needs attention."),
    "get": CommandEntry(
        "cli.get", "Inspect", "List edges, robots, tasks or links; with -w, also their changes."
    ),
    "describe edge": CommandEntry("cli.describe", "Inspect", "Show details of an edge."),
    "describe robot": CommandEntry("cli.describe", "Inspect", "Show details of a robot."),
    "describe task": CommandEntry("cli.describe", "Inspect", "Show details of a task."),
    "top hosts": CommandEntry("cli.top", "Inspect", "Show resource usage of hosts, now and lately."),
    "top tasks": CommandEntry(
        "cli.top", "Inspect", "Show resource usage of tasks against their demand, now and lately."
    ),
    "serve": CommandEntry("cli.serve", "Inspect", "Serve a read-only page of the fleet to browsers."),
    "wait": CommandEntry("cli.wait", "Inspect", "Wait until tasks are ready, completed or gone."),
    "logs": CommandEntry("cli.logs", "Inspect", "Print the logs of tasks."),
    "events": CommandEntry("cli.events", "Inspect", "List recent events."),
    "explain": CommandEntry("cli.explain", "Inspect", "Explain a placement and what would change it."),
    "graph": CommandEntry("cli.graph", "Inspect", "Export the task graph as Mermaid or DOT."),
    "history": CommandEntry("cli.history", "Inspect", "List applied revisions."),
    "show": CommandEntry("cli.history", "Inspect", "Show a revision or a saved plan."),
    "profile": CommandEntry(
        "cli.profile", "Inspect", "Show measured usage of a task; --write saves it as its demand."
    ),
    "stop": CommandEntry("cli.stop", "Operate", "Stop tasks."),
    "start": CommandEntry("cli.stop", "Operate", "Start tasks that are stopped, failed or completed."),
    "restart": CommandEntry("cli.stop", "Operate", "Restart tasks in place."),
    "move": CommandEntry("cli.pins", "Operate", "Pin a task to a host, for a time or until unpinned."),
    "unpin": CommandEntry("cli.pins", "Operate", "Let tasks be placed by utility again."),
    "rollback": CommandEntry("cli.history", "Operate", "Restore the placement of an earlier revision."),
    "cordon": CommandEntry("cli.operator_marks", "Operate", "Mark hosts as unschedulable."),
    "uncordon": CommandEntry("cli.operator_marks", "Operate", "Mark hosts as schedulable."),
    "drain": CommandEntry("cli.drain", "Operate", "Cordon hosts and move their tasks away."),
    "fence": CommandEntry(
        "cli.operator_marks", "Operate", "Declare a host powered off so that its tasks can be rescheduled."
    ),
    "unfence": CommandEntry("cli.operator_marks", "Operate", "Clear the fence of hosts."),
    "done": CommandEntry(
        "cli.operator_marks", "Operate", "Mark tasks as completed; they are stopped and stay stopped."
    ),
    "reopen": CommandEntry(
        "cli.operator_marks", "Operate", "Make completed or failed tasks schedulable again."
    ),
    "exec": CommandEntry("cli.enter", "Operate", "Run a command where a task runs, in its environment."),
    "ssh": CommandEntry("cli.enter", "Operate", "Log in to a host, or run a command there."),
    "trust": CommandEntry("cli.trust", "Operate", "Record the SSH host keys of hosts."),
    "doctor": CommandEntry("cli.doctor", "Operate", "Diagnose hosts, links and configuration."),
    "profilers start": CommandEntry("cli.profilers", "Operate", "Start resident profilers on the hosts."),
    "profilers status": CommandEntry("cli.profilers", "Operate", "Show resident profilers and their cost."),
    "profilers stop": CommandEntry("cli.profilers", "Operate", "Stop resident profilers."),
    "counters install": CommandEntry(
        "cli.counters", "Operate", "Install byte counters on edges, so that UDP is measured."
    ),
    "counters show": CommandEntry("cli.counters", "Operate", "Show the bytes of each robot."),
    "counters remove": CommandEntry("cli.counters", "Operate", "Remove the byte counters from edges."),
    "replay": CommandEntry(
        "experiments.commands.replay",
        "Evaluate",
        "Re-run the scheduler on recorded snapshots under other policies.",
    ),
    "simulate run": CommandEntry(
        "experiments.commands.simulate",
        "Evaluate",
        "Simulate a mission under several schemes.",
    ),
    "simulate sweep": CommandEntry(
        "experiments.commands.sweep", "Evaluate", "Simulate a mission in many worlds, on all cores."
    ),
    "simulate merge": CommandEntry(
        "experiments.commands.sweep", "Evaluate", "Merge the results of the shards of a sweep."
    ),
    "experiment run": CommandEntry(
        "experiments.commands.experiment",
        "Evaluate",
        "Run a mission on real hosts under several schemes.",
    ),
    "experiment show": CommandEntry(
        "experiments.commands.experiment", "Evaluate", "Compare the results of an experiment so far."
    ),
    "report": CommandEntry(
        "experiments.commands.report",
        "Evaluate",
        "Render an experiment as HTML and figures.",
    ),
    "ssim": CommandEntry(
        "experiments.commands.ssim", "Evaluate", "Score a robot's map against ground truth (SSIM)."
    ),
    "init": CommandEntry("cli.offline_commands", "Files", "Create an example fleet."),
    "validate": CommandEntry("cli.offline_commands", "Files", "Check inventory and task files offline."),
    "schema": CommandEntry("cli.schema", "Files", "Print the JSON Schema of a file or document."),
    "import ros": CommandEntry("cli.import_", "Files", "Make tasks and an inventory from ROS launch files."),
    "import ssh": CommandEntry("cli.import_", "Files", "Make an inventory of hosts in the ssh_config."),
    "import ansible": CommandEntry("cli.import_", "Files", "Make an inventory from an Ansible inventory."),
    "import paper": CommandEntry(
        "cli.import_", "Files", "Make tasks from a requirement file of the paper's authors."
    ),
    "import compose": CommandEntry("cli.import_", "Files", "Make tasks from a compose file."),
    "export prometheus": CommandEntry(
        "cli.export", "Files", "Export measurements and decisions as Prometheus metrics."
    ),
    "export ros": CommandEntry("cli.export_ros", "Files", "Publish the state of the fleet in ROS."),
    "export csv": CommandEntry("cli.export", "Files", "Export the history as CSV."),
    "export jsonl": CommandEntry("cli.export", "Files", "Export the history as JSON Lines."),
    "export cron": CommandEntry(
        "cli.export_jobs", "Files", "Print a crontab line that applies periodically."
    ),
    "export systemd": CommandEntry(
        "cli.export_jobs", "Files", "Print systemd units that apply periodically, or watch."
    ),
    "export kubernetes": CommandEntry(
        "cli.export_engines", "Files", "Print Kubernetes manifests of the tasks where the plan puts them."
    ),
    "export nomad": CommandEntry(
        "cli.export_engines", "Files", "Print Nomad jobs of the tasks where the plan puts them."
    ),
    "export compose": CommandEntry(
        "cli.export_engines", "Files", "Print a compose file of each host's tasks in the plan."
    ),
    "export bluechi": CommandEntry(
        "cli.export_engines", "Files", "Print systemd units and BlueChi commands of the plan."
    ),
    "config view": CommandEntry(
        "cli.config", "Settings", "Show the settings in effect; with --origin, where each comes from."
    ),
    "config use-context": CommandEntry("cli.config", "Settings", "Choose the context of later commands."),
    "config get-contexts": CommandEntry("cli.config", "Settings", "List the contexts."),
    "config current-context": CommandEntry("cli.config", "Settings", "Print the name of the context."),
    "version": CommandEntry("cli.offline_commands", "Settings", "Print the version."),
    "completion": CommandEntry("cli.offline_commands", "Settings", "Print the completion script of a shell."),
}
# Help of the command groups.
GROUP_HELP: dict[str, str] = {
    "describe": "Show details of an edge, robot or task.",
    "top": "Show resource usage: of hosts by default (-w to refresh, -i for the full-screen view).",
    "profilers": "Manage resident profilers on the hosts.",
    "counters": "Manage byte counters of the traffic with each robot, on the edges.",
    "import": "Import launch files and host lists of other tools.",
    "export": "Export for cron, systemd, Prometheus, ROS, CSV, Kubernetes, Nomad and others.",
    "experiment": "Compare schemes on real hosts.",
    "simulate": "Simulate a mission under several schemes: simulate SCENARIO is simulate run SCENARIO.",
    "config": "Show and choose the settings of edgectl.yaml and of the user.",
}
# Examples of a command group, a line each.
GROUP_EXAMPLES: dict[str, tuple[str, ...]] = {
    "describe": ("edgectl describe task detection-robot1",),
    "top": ("edgectl top", "edgectl top -w", "edgectl top tasks -o wide"),
    "profilers": ("edgectl profilers start", "edgectl profilers status"),
    "counters": ("edgectl counters install", "edgectl counters show"),
    "import": ("edgectl import ros bringup.launch rate:=2", "edgectl import ssh 'jetson-*'"),
    "export": ("edgectl export cron --every 15m", "edgectl export csv tasks --since 1h"),
    "experiment": (
        "edgectl experiment run tasks/patrol/experiment.yaml --dry-run",
        "edgectl experiment show docs/examples/run",
    ),
    "simulate": (
        "edgectl simulate docs/scenarios/paper-2.yaml --runs 2",
        "edgectl simulate sweep docs/scenarios/sweep-robots.yaml",
    ),
    "config": ("edgectl config view --origin", "edgectl config get-contexts"),
}
SUMMARY = "Place robot tasks on edge computers by measured utility: probe, plan, apply, over SSH."
EPILOG = (
    "Exit codes: 0 done; 1 failed; 2 changes pending, 3 unplaced (plan --detailed-exitcode); 4 partly "
    "done; 64 usage; "
    "75 locked, stale or busy, try again; 130 interrupted.\n\n"
    "Environment: EDGECTL_INVENTORY, EDGECTL_TASKS, EDGECTL_CONTEXT, EDGECTL_OUTPUT, EDGECTL_STATE_DIR, "
    "EDGECTL_INSECURE_FILES, EDGECTL_SSH_CONFIG, EDGECTL_DEBUG, CI, NO_COLOR, FORCE_COLOR."
)
_TO_IDENTIFIER = str.maketrans(" -", "__")
CONTEXT_SETTINGS: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class SectionedHelpGroup(TyperGroup):
    """Help with commands in their groups, and with examples that keep their lines."""

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
    """The application for this command line: all names, but options only of the requested command."""
    completing = "_EDGECTL_COMPLETE" in os.environ
    named = [word for word in words if not word.startswith("-")]
    wanted = " ".join(named[: 2 if named and named[0] in GROUP_HELP else 1])
    # After an option of the application its help may follow, which lists all commands.
    alone = wanted in COMMANDS and words[0] == named[0] and not completing
    return build_app_with_commands(
        list(COMMANDS) if completing else [wanted], completing=completing, alone=alone
    )


def build_app_with_commands(
    wanted: Sequence[str], *, completing: bool = False, alone: bool = False
) -> typer.Typer:
    """The application with the options of the commands in ``wanted``; ``alone``: without all others."""
    app = typer.Typer(
        cls=SectionedHelpGroup,
        add_completion=completing,
        rich_markup_mode=None,
        context_settings=CONTEXT_SETTINGS,
        epilog=EPILOG,
        no_args_is_help=False,
        pretty_exceptions_enable=False,
    )
    app.callback(help=SUMMARY)(_root_callback)
    names = wanted if alone else COMMANDS
    shown_groups = {name.partition(" ")[0] for name in names}
    groups = {
        name: _add_command_group(app, name, text) for name, text in GROUP_HELP.items() if name in shown_groups
    }
    for name in names:
        entry = COMMANDS[name]
        first, _, second = name.partition(" ")
        place = groups.get(first, app)
        if name in wanted:
            from edgectl.cli.options import expand_option_groups

            function = getattr(
                import_module(f"edgectl.{entry.module}"), f"{name.translate(_TO_IDENTIFIER)}_command"
            )
            text, examples = split_docstring(function)
            place.command(
                second or name,
                help=text,
                epilog=f"\b\nExamples:\n{examples}",
                context_settings=CONTEXT_SETTINGS,
            )(expand_option_groups(function))
        else:
            place.command(second or name, help=entry.help)(_placeholder_command)
    return app


def _add_command_group(app: typer.Typer, name: str, text: str) -> typer.Typer:
    """Add a command group; called without a subcommand it prints its help."""
    group = typer.Typer(rich_markup_mode=None, context_settings=CONTEXT_SETTINGS, no_args_is_help=True)
    examples = "".join(f"  {example}\n" for example in GROUP_EXAMPLES.get(name, ()))
    epilog = f"\b\nExamples:\n{examples}" if examples else None
    app.add_typer(group, name=name, help=text, epilog=epilog)
    return group


def _print_version(wanted: bool) -> None:  # noqa: FBT001 - typer passes it by position
    if wanted:
        typer.echo(f"edgectl {__version__}")
        raise typer.Exit


def _complete_contexts(incomplete: str) -> list[str]:
    from edgectl.cli.completion import complete_contexts

    return complete_contexts(incomplete)


def _root_callback(
    context_of_call: typer.Context,
    *,
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    _insecure_files: Annotated[
        bool, typer.Option("--insecure-files", help="Act on files that other users may write.")
    ] = False,
    context: Annotated[
        str | None,
        typer.Option(
            "--context",
            metavar="NAME",
            autocompletion=_complete_contexts,
            help="A fleet that edgectl.yaml or the user's configuration names.",
        ),
    ] = None,
    color: Annotated[
        Literal["auto", "always", "never"], typer.Option("--color", help="Colour the output.")
    ] = "auto",
    verbose: Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="Print requests to hosts; -vv: and SSH.")
    ] = 0,
    log_format: Annotated[
        Literal["text", "json"], typer.Option("--log-format", help="Format of -v.")
    ] = "text",
) -> None:
    """Options of every command. The entry point acts on --insecure-files: settings are read before this."""
    if verbose:
        from edgectl.cli.verbosity import show_trace

        context_of_call.with_resource(show_trace(verbose, log_format))
    if color != "auto":
        # Children, such as a pager or ssh, are told the same way.
        for name in ("NO_COLOR", "FORCE_COLOR"):
            os.environ.pop(name, None)
        os.environ["FORCE_COLOR" if color == "always" else "NO_COLOR"] = "1"
    if context is not None or "edgectl.cli.project" in sys.modules:
        from edgectl.cli.project import use_context_option

        use_context_option(context)


def _placeholder_command() -> None:
    """Stand-in for a command that is not requested."""


def split_docstring(function: Callable[..., object]) -> tuple[str, str]:
    """The docstring of a command, split into its description and its examples, one per line."""
    text, _, examples = (function.__doc__ or "").partition("Examples:")
    return text.strip(), "\n".join(f"  {line.strip()}" for line in examples.strip().splitlines())
