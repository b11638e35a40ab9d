# SPDX-License-Identifier: Apache-2.0
"""trust command."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from edgectl.cli import apply_session, console, options
from edgectl.cli.completion import complete_hosts
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode, HostError, UsageError
from edgectl.model.host_key import HostKeyReport
from edgectl.names import check_known_names
from edgectl.transport.known_hosts import HostKeyVerdict
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.transport.trust import ShownKey

_MAX_PARALLEL = 16


def trust_command(
    *,
    names: Annotated[
        list[str] | None,
        Argument(
            metavar="[HOST...]",
            autocompletion=complete_hosts,
            parser=options.strip_host_kind,
            help="Names in the inventory.",
            show_default=False,
        ),
    ] = None,
    every: Annotated[bool, Option("--all", help="Every host that is ever contacted.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Show the fingerprints of host keys, ask once, and record the new ones in known_hosts. A key that has
    changed is never replaced. Exit 4 while a host has no recorded key.

    Examples:
        edgectl trust edge1 --yes
        edgectl trust --all --yes
        edgectl trust --all --dry-run
    """
    from edgectl.gateway.fanout import fan_out
    from edgectl.transport.trust import fetch_host_key, list_ssh_hosts
    from edgectl.views.host_keys import HostKeysView

    if bool(names) == every:
        raise UsageError("name hosts, or pass --all", hint="edgectl trust edge1")
    fleet = load_inputs(inventory, tasks, needs_tasks=False).inventory
    hosts = fleet.hosts
    check_known_names(names or (), hosts, "host")
    asked = names or (name for name, host in hosts.items() if host.probe)
    wanted = list_ssh_hosts([hosts[name] for name in dict.fromkeys(asked)])
    found = dict(fan_out(fetch_host_key, wanted, workers=_MAX_PARALLEL))
    shown = [found[position] for position in range(len(wanted))]
    console.print_view(HostKeysView([_report_key(each) for each in shown]), output, fleet=fleet.fleet)
    unknown = [each for each in shown if each.verdict is HostKeyVerdict.UNKNOWN]
    if dry_run:
        for each in unknown:
            console.print_message(f"{each.host.name}: would be recorded (dry run)")
    elif unknown and not yes:
        _ask_to_trust(unknown, fleet.fleet)
    recorded = [not dry_run and _record_key(each) for each in unknown]
    settled = all(each.verdict in (HostKeyVerdict.KNOWN, HostKeyVerdict.UNKNOWN) for each in shown)
    raise Exit(ExitCode.DONE if settled and all(recorded) else ExitCode.PARTLY)


def _report_key(shown: "ShownKey") -> HostKeyReport:
    key, error = shown.key, shown.error
    # That a key is not known yet is what this command is for.
    said = error if error is not None and shown.verdict is not HostKeyVerdict.UNKNOWN else None
    return HostKeyReport(
        host=shown.host.name,
        key_type=key.kind if key is not None else "",
        fingerprint=key.fingerprint if key is not None else "",
        state=shown.verdict.value if shown.verdict is not None else "no answer",
        error=said.message if said is not None else "",
        hint=said.hint if said is not None else "",
    )


def _ask_to_trust(unknown: "Sequence[ShownKey]", fleet: str) -> None:
    from edgectl.transport.trust import get_public_key_path
    from edgectl.views.text import wrap_text

    names = [each.host.name for each in unknown]
    where = f"on {names[0]} itself" if len(names) == 1 else f"on each of {', '.join(names)}"
    kinds = dict.fromkeys(each.key.kind for each in unknown if each.key is not None)
    compare = " && ".join(f"ssh-keygen -lf {get_public_key_path(kind)}" for kind in kinds)
    first = f"compare each fingerprint with the output of this command {where}: {compare}"
    apply_session.check_can_confirm(asked=True, first=first)
    many = names[0] if len(names) == 1 else f"these {len(names)} hosts"
    told = wrap_text(f"{first[0].upper()}{first[1:]}", console.get_stderr_render_options())
    question = f'{told}Trust {many} of fleet {fleet}? Only "yes" is accepted: '
    if not apply_session.ask_confirmation(question):
        raise Exit(ExitCode.FAILED)


def _record_key(shown: "ShownKey") -> bool:
    """Whether the key has been recorded; a failure is printed."""
    from edgectl.transport.trust import trust_host_key

    try:
        console.print_message(f"{shown.host.name}: recorded in {trust_host_key(shown)}")
    except HostError as error:
        console.print_message(f"{shown.host.name}: {error.message}")
        return False
    return True
