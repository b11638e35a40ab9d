# SPDX-License-Identifier: Apache-2.0
"""Checks of one host that answered."""

from edgectl.doctor.containers import diagnose_engines
from edgectl.doctor.disk import diagnose_disk
from edgectl.doctor.hardware import diagnose_hardware
from edgectl.doctor.ssh_command import format_ssh_command
from edgectl.model.diagnosis import Finding, HostFacts, LinkFacts, Logind, Severity, ShellEnvironment
from edgectl.model.inventory import Connection, Host, Inventory
from edgectl.model.snapshot import CapacitySource
from edgectl.units import format_bytes, format_duration, format_rate

_SLOW_LOGIN_S = 3.0
# tf of ROS and its message filters give up well below a second.
_MAX_SKEW_S = 0.5
_MIN_FREE_SHARE, _MIN_FREE_BYTES = 0.10, 64 * 2**20


def diagnose_host(host: Host, facts: HostFacts, inventory: Inventory) -> list[Finding]:
    """One finding per check, from the login to the links."""
    return [
        _diagnose_login(host, facts),
        _diagnose_python(host, facts),
        _diagnose_clock(host, facts),
        _diagnose_logind(host, facts.logind),
        diagnose_disk(host.name, facts.disk),
        _diagnose_memory(host, facts),
        *diagnose_hardware(host, facts.hardware),
        _diagnose_prelude(host, facts.surroundings),
        *diagnose_engines(host.name, facts.logind.user, facts.engines),
        *(_diagnose_robot_link(host, inventory.hosts[robot], link) for robot, link in facts.links.items()),
        *_diagnose_link_capacity(host, facts, inventory),
    ]


def _build_finding(
    host: Host, check: str, message: str, mend: str = "", level: Severity = Severity.WARNING
) -> Finding:
    return Finding(
        host=host.name, check=check, level=level if mend else Severity.OK, message=message, remedy=mend
    )


def _diagnose_login(host: Host, facts: HostFacts) -> Finding:
    took = f"{facts.login_s:.2f}s"
    if host.connection is Connection.LOCAL:
        return _build_finding(host, "login", f"is this machine, answered in {took}")
    if facts.login_s <= _SLOW_LOGIN_S:
        return _build_finding(host, "login", f"{took}, host key known")
    mend = (
        f"find the slow step: {format_ssh_command(host, '-vvv')} true; "
        f"often UseDNS no in /etc/ssh/sshd_config of {host.name} helps"
    )
    return _build_finding(host, "login", f"{took} for every command; host key known", mend)


def _diagnose_python(host: Host, facts: HostFacts) -> Finding:
    """Without psutil, which is optional, the agent reads /proc itself, with the same figures."""
    return _build_finding(
        host,
        "python",
        f"{facts.python}, {'psutil' if facts.psutil else 'no psutil: /proc is read instead, same figures'}",
    )


def _diagnose_clock(host: Host, facts: HostFacts) -> Finding:
    """Only the certain part of the skew counts; a slow link widens its range."""
    if host.connection is Connection.LOCAL:
        return _build_finding(host, "clock", "is this machine's")
    least, most = facts.skew_s
    sure = max(least, -most, 0.0)
    if sure <= _MAX_SKEW_S:
        return _build_finding(
            host,
            "clock",
            "agrees with this machine's"
            + (f" within {max(-least, most, 0.0):.2f}s" if most - least < _MAX_SKEW_S else ""),
        )
    direction = "ahead of" if least > 0 else "behind"
    message = (
        f"is {format_duration(sure)} {direction} this machine's: ROS drops messages with distant time stamps"
    )
    by_hand = f'; without a time server: {format_ssh_command(host)} sudo date -s "@$(date +%s)"'
    return _build_finding(host, "clock", message, f"on {host.name}: sudo timedatectl set-ntp true{by_hand}")


def _diagnose_logind(host: Host, logind: Logind) -> Finding:
    """Robots too: the end of an SSH session of edgectl may remove the shared memory of ROS 2."""
    user = logind.user
    linger = f"on {host.name}: sudo loginctl enable-linger {user}"
    if not logind.present:
        return _build_finding(host, "logind", "no logind; nothing ends with a login")
    if logind.lingers:
        return _build_finding(host, "logind", f"{user} lingers; nothing ends with a login")
    if logind.kills:
        message = (
            f"KillUserProcesses=yes and {user} does not linger: "
            "tasks would be killed at logout, so starts are refused"
        )
        return _build_finding(host, "logind", message, linger, Severity.FAILED)
    if logind.removes_ipc:
        message = (
            f"RemoveIPC=yes and {user} does not linger: "
            "shared memory is removed at the last logout, and ROS 2 stops communicating"
        )
        return _build_finding(host, "logind", message, linger)
    return _build_finding(host, "logind", f"nothing of {user} ends with a login")


def _diagnose_memory(host: Host, facts: HostFacts) -> Finding:
    free = facts.total_bytes - facts.used_bytes
    message = f"{format_bytes(free)} of {format_bytes(facts.total_bytes)} free"
    if free >= max(_MIN_FREE_SHARE * facts.total_bytes, _MIN_FREE_BYTES):
        return _build_finding(host, "memory", message)
    mend = f"on {host.name}, stop what is not needed: ps -eo rss,pid,args --sort=-rss | head"
    return _build_finding(
        host, "memory", message, mend, Severity.FAILED if free < _MIN_FREE_BYTES else Severity.WARNING
    )


def _diagnose_prelude(host: Host, seen: ShellEnvironment) -> Finding:
    said = f": {seen.last_line}" if seen.last_line else ""
    edit = f"correct prelude: of {host.name} in the inventory; try: edgectl doctor {host.name}"
    if not host.prelude:
        return _build_finding(host, "prelude", "none")
    if seen.timed_out:
        return _build_finding(
            host,
            "prelude",
            f"does not end in time{said}; no task can start",
            edit,
            Severity.FAILED,
        )
    if seen.status is None:
        return _build_finding(
            host, "prelude", f"exits the shell{said}; no task can start", edit, Severity.FAILED
        )
    if seen.status:
        return _build_finding(host, "prelude", f"ends with status {seen.status}{said}", edit)
    return _build_finding(host, "prelude", "runs")


def _diagnose_robot_link(host: Host, robot: Host, link: LinkFacts) -> Finding:
    """Whether the robot can be reached *from* the edge, which does not follow from reaching both."""
    check, name = "robot", robot.name
    if not link.found:
        mend = (
            f"set host: of {name} to its address in the inventory; "
            f"or on {host.name}: echo 'ADDRESS {link.address}' | sudo tee -a /etc/hosts"
        )
        return _build_finding(
            host,
            check,
            f"{name} is {link.address}, a name that {host.name} cannot resolve",
            mend,
            Severity.FAILED,
        )
    if link.reachable:
        rtt = "" if link.rtt_ms is None else f" in {link.rtt_ms:.1f}ms"
        return _build_finding(host, check, f"{name} answers{rtt}")
    if link.interface is None:
        mend = (
            f"correct host: of {name} in the inventory, "
            f"or give {host.name} a route: ip route get {link.address}"
        )
        return _build_finding(
            host, check, f"no route from {host.name} to {name} ({link.address})", mend, Severity.FAILED
        )
    if link.reachable is None and not robot.probe:
        return _build_finding(host, check, f"no reply from {name} (probe: false, assumed to be reachable)")
    if link.reachable is None:
        mend = (
            f"switch {name} on, or let {host.name} through its firewall, "
            f"on {name}: sudo ufw allow from {host.host}"
        )
        return _build_finding(host, check, f"no reply from {name} ({link.address}) to {host.name}", mend)
    mend = f"switch {name} on, and join both to one network; on {host.name}: ping -c3 {link.address}"
    return _build_finding(
        host, check, f"{name} ({link.address}) cannot be reached from {host.name}", mend, Severity.FAILED
    )


def _diagnose_link_capacity(host: Host, facts: HostFacts, inventory: Inventory) -> list[Finding]:
    """One finding for all links of an edge: the capacities, or those that are assumed."""
    if not facts.links:
        return []
    assumed = [robot for robot, link in facts.links.items() if link.capacity_source is CapacitySource.ASSUMED]
    if not assumed:
        known = (
            f"{robot} {format_rate(link.capacity_bytes_per_s)} ({link.capacity_source})"
            for robot, link in facts.links.items()
        )
        return [_build_finding(host, "capacity", ", ".join(known))]
    rate = format_rate(facts.links[assumed[0]].capacity_bytes_per_s)
    measurable = all(inventory.hosts[robot].probe for robot in assumed)
    stated = f"links: [{{edge: {host.name}, robot: {assumed[0]}, throughput: ..}}] in the inventory"
    mend = f"edgectl probe --bandwidth; or {stated}" if measurable else stated
    return [
        _build_finding(
            host, "capacity", f"of the link to {', '.join(assumed)} is unknown, {rate} is assumed", mend
        )
    ]
