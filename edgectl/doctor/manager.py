# SPDX-License-Identifier: Apache-2.0
"""Checks of the machine on which edgectl runs."""

from shlex import quote

from edgectl.doctor.disk import diagnose_disk
from edgectl.model.diagnosis import EtcdEndpoint, Finding, ManagerFacts, Severity
from edgectl.model.inventory import Connection, Inventory


def diagnose_manager(inventory: Inventory, facts: ManagerFacts) -> list[Finding]:
    """State directory, known_hosts and the ssh program, the last two only where a host needs them; the fleet
    only if the inventory does not name it; each endpoint of etcd where the inventory names one.
    """
    connections = {host.connection for host in inventory.hosts.values() if host.probe}
    findings = [diagnose_disk(None, facts.state)]
    if not inventory.is_fleet_named:
        findings.append(_build_unnamed_fleet_finding(inventory.fleet))
    if connections - {Connection.LOCAL}:
        findings += _diagnose_known_hosts(facts)
    if Connection.OPENSSH in connections:
        findings.append(_diagnose_ssh_program(facts))
    serves = any(not endpoint.error for endpoint in facts.etcd)
    return findings + [_diagnose_etcd(endpoint, serves=serves) for endpoint in facts.etcd]


def _diagnose_etcd(endpoint: EtcdEndpoint, *, serves: bool) -> Finding:
    """An endpoint that fails is a warning while another one ``serves`` requests: a majority is left."""
    if endpoint.error:
        return Finding(
            host=None,
            check="etcd",
            level=Severity.WARNING if serves else Severity.FAILED,
            message=f"{endpoint.address}: {endpoint.error}",
            remedy="there: systemctl status etcd; or correct coordination: in the inventory",
        )
    return Finding(
        host=None,
        check="etcd",
        level=Severity.OK,
        message=f"{endpoint.address} serves requests, version {endpoint.version}",
    )


def _build_unnamed_fleet_finding(fleet: str) -> Finding:
    return Finding(
        host=None,
        check="fleet",
        level=Severity.WARNING,
        message=f"the inventory names no fleet; {fleet} stands for the path of its file",
        remedy=f"add to the inventory: fleet: {fleet}",
    )


def _diagnose_known_hosts(facts: ManagerFacts) -> list[Finding]:
    broken = [_build_unreadable_finding(path, why) for path, why in facts.known_hosts.items() if why]
    files = ", ".join(facts.known_hosts)
    message = f"{files} can be read" if files else "none yet; edgectl trust HOST writes it"
    return broken or [Finding(host=None, check="known_hosts", level=Severity.OK, message=message)]


def _build_unreadable_finding(path: str, why: str) -> Finding:
    file = quote(path)
    mend = (
        f"sudo chown $USER {file} && chmod 600 {file}"
        if why == "Permission denied"
        else f"mv {file} {file}.old"
    )
    return Finding(
        host=None,
        check="known_hosts",
        level=Severity.FAILED,
        message=f"{path} cannot be read: {why}",
        remedy=mend,
    )


def _diagnose_ssh_program(facts: ManagerFacts) -> Finding:
    if facts.ssh:
        return Finding(host=None, check="ssh", level=Severity.OK, message="ssh program found")
    mend = "sudo apt-get install openssh-client   (or connection: ssh in the inventory)"
    return Finding(
        host=None,
        check="ssh",
        level=Severity.FAILED,
        message="connection: openssh needs an ssh program; none found",
        remedy=mend,
    )
