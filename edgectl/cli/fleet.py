"""trust, cordon, uncordon, fence, unfence, done, reopen."""

from collections.abc import Iterable
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import acting, console, options
from edgectl.cli.inputs import load
from edgectl.errors import ExitCode
from edgectl.model.names import known


def trust_command(
    *,
    host: options.HostArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    yes: options.YesOption = False,
) -> None:
    """Show the fingerprint of the key that a host shows; after a yes it is remembered in known_hosts.

    Examples:
        edgectl trust edge1 --yes
    """
    from edgectl.transport.trust import fetch_host_keys, key_file, trust

    loaded = load(inventory, tasks)
    known([host], loaded.inventory.hosts, "host")
    keys = fetch_host_keys(loaded.inventory.hosts[host])
    if not keys:
        console.put(f"{host} is this machine; it has no host key\n")
        return
    for kind, fingerprint, _ in keys:
        console.put(f"{host} {kind} {fingerprint}\n")
    compare = " && ".join(f"ssh-keygen -lf {key_file(kind)}" for kind, _, _ in keys)
    acting.answerable(asked=not yes, first=f"compare the fingerprint with what this prints on {host} itself: {compare}")
    if not yes and not acting.ask(f'Compare with what this prints on {host} itself: {compare}\nTrust it? Only "yes" is accepted: '):
        raise Exit(ExitCode.FAILED)
    for _, _, line in keys:
        console.tell(f"remembered in {trust(loaded.inventory.hosts[host], line)}")


def cordon_command(
    *,
    hosts: options.HostsArgument,
    drain: Annotated[bool, Option("--drain", help="Tasks leave too, at the next apply.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
) -> None:
    """Close hosts to new tasks.

    Examples:
        edgectl cordon edge1
        edgectl cordon edge1 --drain
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import marks

    memory = marks.cordon(reach(load(inventory, tasks)), hosts, drain=drain)
    _say("cordoned", memory.cordons)


def uncordon_command(hosts: options.HostsArgument, inventory: options.InventoryOption = None, tasks: options.TasksOption = None) -> None:
    """Open cordoned hosts again.

    Examples:
        edgectl uncordon edge1
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import marks

    memory = marks.uncordon(reach(load(inventory, tasks)), hosts)
    _say("cordoned", memory.cordons)


def fence_command(
    *,
    host: options.HostArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    yes: options.YesOption = False,
) -> None:
    """Say that a host is switched off, so that its tasks may start elsewhere at the next apply although it cannot be asked.

    Make sure first: a task that still runs there would run twice. A host that answers again is fenced no longer.

    Examples:
        edgectl fence edge1 --yes
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import marks

    loaded = load(inventory, tasks)
    known([host], loaded.inventory.hosts, "host")
    acting.answerable(asked=not yes)
    if not yes and not acting.ask(f"If {host} still runs, its tasks will run twice. Type its name if it is switched off: ", host):
        raise Exit(ExitCode.FAILED)
    _say("fenced", marks.fence(reach(loaded), [host]))


def unfence_command(hosts: options.HostsArgument, inventory: options.InventoryOption = None, tasks: options.TasksOption = None) -> None:
    """Take back that hosts are switched off.

    Examples:
        edgectl unfence edge1
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import marks

    _say("fenced", marks.unfence(reach(load(inventory, tasks)), hosts))


def done_command(names: options.TasksArgument, inventory: options.InventoryOption = None, tasks: options.TasksOption = None) -> None:
    """Say that tasks have completed: the next apply stops them, and they stay stopped until reopened or changed.

    Examples:
        edgectl done navigation-robot1
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import marks

    memory = marks.done(reach(load(inventory, tasks)), names)
    _say("done", memory.done)


def reopen_command(names: options.TasksArgument, inventory: options.InventoryOption = None, tasks: options.TasksOption = None) -> None:
    """Let completed tasks, and tasks that were given up, be scheduled again.

    Examples:
        edgectl reopen navigation-robot1
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import marks

    memory = marks.reopen(reach(load(inventory, tasks)), names)
    _say("done", memory.done)


def _say(what: str, names: Iterable[str]) -> None:
    console.put(f"{what}: {', '.join(sorted(names)) or 'none'}\n")
