"""profile."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import acting, console, options
from edgectl.cli.inputs import load, replaced, task_files
from edgectl.errors import ExitCode
from edgectl.model.names import known
from edgectl.views.form import Form


def profile_command(
    *,
    task: options.TaskArgument,
    write: Annotated[bool, Option("--write", help="Put p95 into the task file, and nothing else.")] = False,
    yes: options.YesOption = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
) -> None:
    """Show what a task was measured to use, by class of hosts: median, p95 and most, beside what is declared. No host is contacted.

    TASK may also be an entry that is made for each robot. --write shows the change and asks.

    Examples:
        edgectl profile slam-robot1
        edgectl profile slam-robot1 -o json
        edgectl profile slam-robot1 --write --yes
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.demands import profiles
    from edgectl.usecases.profile import rewrite, tasks_named

    acting.answerable(asked=write and not yes, first="look first: edgectl profile TASK")
    files = task_files(tasks)
    fleet = reach(load(inventory, files))
    known([task], [*fleet.tasks.tasks, *(each.template for each in fleet.tasks.tasks.values())], "task")
    named = tasks_named(fleet.tasks, task)
    console.show(output, "profile", profiles(fleet, named))
    if not write:
        return
    change = rewrite(fleet, files, named[0])
    if change.before == change.after:
        console.tell(f"{change.file} says so already")
        return
    if len(change.tasks) > 1:
        console.tell(f"{change.entry} is one entry for {', '.join(change.tasks)}: it gets the greatest p95 of them")
    console.say(change.diff())
    if not yes and not acting.ask(f'Write this to {change.file}? Only "yes" is accepted: '):
        raise Exit(ExitCode.FAILED)
    replaced(change.file, change.before, change.after)
    console.tell(f"wrote {change.file}")
