# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of a fleet: this machine, hosts that answered, hosts that did not."""

from collections.abc import Iterable, Sequence

from edgectl.doctor.host import diagnose_host
from edgectl.doctor.manager import diagnose_manager
from edgectl.doctor.ros import diagnose_ros
from edgectl.doctor.shortage import diagnose_shortages
from edgectl.doctor.ssh_command import format_copy_id_command, format_ssh_command
from edgectl.doctor.traffic import diagnose_traffic
from edgectl.model.assignment import Shortage
from edgectl.model.diagnosis import (
    Diagnosis,
    FactsByHost,
    Finding,
    HostFacts,
    ManagerFacts,
    Severity,
    UnreachableHost,
)
from edgectl.model.inventory import Host, Inventory
from edgectl.model.snapshot import Snapshot

# HostError.kind -> the check that failed.
_CHECKS = {
    "connect": "reachability",
    "deadline": "reachability",
    "host-key": "host key",
    "auth": "login",
    "no-python": "python",
}
_INSTALL_PYTHON = "on {name}: sudo apt-get install python3   (3.6 or later)"


def diagnose_no_answer(host: Host, answer: UnreachableHost) -> Finding:
    """The finding of a host that did not answer."""
    check = _CHECKS.get(answer.kind, "agent")
    return Finding(
        host=host.name,
        check=check,
        level=Severity.FAILED,
        message=answer.error,
        remedy=_suggest_fix(host, answer),
    )


def _suggest_fix(host: Host, answer: UnreachableHost) -> str:
    """A command or an edit; for some errors their own hint."""
    name, port = host.name, f" on port {host.port}" if host.port else ""
    by_kind = {
        "connect": f"switch {name} on and check that sshd runs there{port}, "
        f"or correct its host: ({host.host}) in the inventory",
        "deadline": f"check its load: {format_ssh_command(host)} uptime; "
        f"for a slow link: edgectl doctor {name} --timeout 60s",
        "auth": f"install your key: {format_copy_id_command(host)}; "
        "or set another one: identity_file: in the inventory",
        "no-python": _INSTALL_PYTHON.format(name=name),
    }
    if answer.kind == "host-key":
        return answer.hint or f"compare the fingerprint, then: edgectl trust {name}"
    if answer.error.startswith("name unknown"):
        return f"correct its host: ({host.host}) in the inventory, or name it in your ssh_config"
    if answer.error.startswith("jump host "):
        return f"see which login fails: {format_ssh_command(host, '-v')} true"
    return (
        by_kind.get(answer.kind, "")
        or answer.hint
        or f"check the output of: {format_ssh_command(host)} python3 --version"
    )


def _build_machine_finding(first: str, name: str) -> Finding:
    """Plan and apply refuse the fleet."""
    return Finding(
        host=name,
        check="machine",
        level=Severity.FAILED,
        message=f"is one machine with {first}: load and tasks would count twice, so no plan is made",
        remedy=f"remove {first} or {name} from the inventory, or declare both as slices with "
        "capacity: {cpu: .., memory: ..}",
    )


def diagnose_fleet(
    inventory: Inventory,
    manager: ManagerFacts,
    answers: FactsByHost,
    shortages: Sequence[Shortage] | None = None,
    snapshot: Snapshot | None = None,
    shared: Iterable[tuple[str, str]] = (),
) -> Diagnosis:
    """Findings about this machine and the fleet as a whole, then host by host in the order of the inventory.

    ``answers``: the hosts that were asked. ``shortages``: what the edges lack, None where it is not known.
    ``snapshot``: a probe of the fleet, where there was one. ``shared``: two hosts each that are one machine.
    """
    findings = diagnose_manager(inventory, manager)
    findings += [] if shortages is None else diagnose_shortages(shortages)
    facts = {name: answer for name, answer in answers.items() if isinstance(answer, HostFacts)}
    ros = diagnose_ros(inventory, facts)
    doubled = {name: first for first, name in shared}
    for name, host in inventory.hosts.items():
        answer = answers.get(name)
        if isinstance(answer, HostFacts):
            findings += [_build_machine_finding(doubled[name], name)] if name in doubled else []
            findings += [*diagnose_host(host, answer, inventory), *ros.get(name, ())]
            findings += diagnose_traffic(name, snapshot)
        elif answer is not None:
            findings.append(diagnose_no_answer(host, answer))
    return Diagnosis(findings=tuple(findings))
