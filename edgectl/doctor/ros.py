# SPDX-License-Identifier: Apache-2.0
"""Checks of ROS variables that differ between hosts: their nodes never find each other, without an error."""

from collections import Counter
from collections.abc import Mapping
from urllib.parse import urlsplit

from edgectl.model.diagnosis import Finding, HostFacts, Severity
from edgectl.model.inventory import Connection, Host, Inventory, Role
from edgectl.model.ros import RosSettings
from edgectl.units import format_bytes

MASTER, DOMAIN, RMW = "ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"
ROS_VARIABLES = (MASTER, DOMAIN, RMW)
# The value in ROS 2 where the variable is not set (the middleware: since Foxy, except Galactic).
_DEFAULTS = {MASTER: "", DOMAIN: "0", RMW: "rmw_fastrtps_cpp"}
_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
_FATAL_VARIABLES = (MASTER, DOMAIN)
# What images and point clouds need of the kernel (the tuning pages of ROS 2).
_RECEIVE_BYTES, _FRAGMENT_BYTES = 8.0 * 2**20, 128.0 * 2**20

FindingsByHost = dict[str, list[Finding]]


def diagnose_ros(inventory: Inventory, facts: Mapping[str, HostFacts]) -> FindingsByHost:
    """Host -> its findings. The value of the majority counts; of equals that of the first host.

    A robot without the variable in our logins is skipped: its own software was started otherwise.
    """
    hosts = {name: host for name, host in inventory.hosts.items() if name in facts}
    found: FindingsByHost = {name: [] for name in hosts}
    for variable in ROS_VARIABLES:
        seen = {name: facts[name].surroundings.variables.get(variable, "") for name in hosts}
        for name, finding in _compare_variable(variable, hosts, seen).items():
            found[name].append(finding)
    for name, host in hosts.items():
        if host.ros is not None:
            found[name] += _diagnose_ros_host(host, host.ros, facts[name])
        if not found[name] and (text := _format_ros_variables(facts[name])):
            found[name] = [Finding(host=name, check="ros", level=Severity.OK, message=text)]
    return found


def _format_ros_variables(facts: HostFacts) -> str:
    return ", ".join(f"{name}={value}" for name, value in facts.surroundings.variables.items() if value)


def _compare_variable(
    variable: str, hosts: Mapping[str, Host], seen: Mapping[str, str]
) -> dict[str, Finding]:
    if not any(seen.values()):
        return {}
    asked = {
        name: value or _DEFAULTS[variable]
        for name, value in seen.items()
        if value or _has_effective_default(hosts[name])
    }
    wanted = _get_majority_value(asked.values())
    found = {
        name: _build_mismatch_finding(variable, hosts[name], seen[name], wanted, asked)
        for name, value in asked.items()
        if value != wanted
    }
    if variable == MASTER and _is_loopback_uri(wanted):
        found |= _diagnose_loopback_masters(hosts, asked)
    return found


def _has_effective_default(host: Host) -> bool:
    return host.role is Role.EDGE or host.onboard


def _get_majority_value(values: object) -> str:
    """The commonest value that is set; the first of equals."""
    counts = Counter(value for value in values if value)  # type: ignore[attr-defined]
    return str(max(counts, key=lambda value: counts[value]))


def _build_mismatch_finding(
    variable: str, host: Host, value: str, wanted: str, asked: Mapping[str, str]
) -> Finding:
    others = [name for name, other in asked.items() if other == wanted]
    has = (
        f"is {value}"
        if value
        else f"is not set ({_DEFAULTS[variable]} by default)"
        if _DEFAULTS[variable]
        else "is not set"
    )
    level = Severity.FAILED if variable in _FATAL_VARIABLES and host.role is Role.EDGE else Severity.WARNING
    message = f"{variable} {has}, but {wanted} on {_format_host_names(others)}"
    return Finding(
        host=host.name,
        check="ros",
        level=level,
        message=message,
        remedy=_suggest_edit(variable, host, wanted),
    )


def _format_host_names(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _suggest_edit(variable: str, host: Host, wanted: str) -> str:
    """A prelude overrides ``env``."""
    if host.prelude:
        return f"in the inventory, end the prelude of {host.name} with: export {variable}={wanted}"
    return f'in the inventory, for {host.name}: env: {{{variable}: "{wanted}"}}'


def _is_loopback_uri(uri: str) -> bool:
    try:
        return urlsplit(uri).hostname in _LOOPBACK_NAMES
    except ValueError:
        return False


def _diagnose_loopback_masters(hosts: Mapping[str, Host], asked: Mapping[str, str]) -> dict[str, Finding]:
    """The name localhost is another machine on each host."""
    machines = {"" if hosts[name].connection is Connection.LOCAL else name for name in asked}
    if len(machines) < 2:
        return {}
    return {
        name: Finding(
            host=name,
            check="ros",
            level=Severity.FAILED if hosts[name].role is Role.EDGE else Severity.WARNING,
            message=f"{MASTER} is {uri}: each host has its own master, so nodes of two hosts never connect",
            remedy=_suggest_edit(MASTER, hosts[name], "http://ADDRESS-OF-THE-MASTER:11311"),
        )
        for name, uri in asked.items()
        if _is_loopback_uri(uri)
    }


def _diagnose_ros_host(host: Host, ros: RosSettings, facts: HostFacts) -> list[Finding]:
    """What a host lacks of the ROS that the inventory states for it."""
    seen = facts.ros
    found = [
        _build_failure(
            host,
            f"set-up file {path} cannot be read, so no task can start",
            f"correct setup in ros: of {host.name} in the inventory, or install ROS on {host.name}",
        )
        for path in seen.missing_files
    ]
    found += [
        _build_failure(
            host,
            f"package {package}, which a task runs, is not found",
            f"install or build it on {host.name} and source its workspace in ros: {{setup: [..]}}; "
            f"or keep the task away: hosts: {{never: [{host.name}]}}",
        )
        for package in seen.missing_packages
    ]
    return [*found, *(_diagnose_dds if ros.version == 2 else _diagnose_addresses)(host, ros, facts)]


def _diagnose_addresses(host: Host, _ros: RosSettings, facts: HostFacts) -> list[Finding]:
    """A node of ROS 1 announces one address; robots on two networks need two."""
    ways: dict[str, str] = {}
    for robot, address in facts.ros.addresses.items():
        ways.setdefault(address, robot)
    if len(ways) < 2:
        return []
    shown = ", ".join(f"{address} to {robot}" for address, robot in ways.items())
    message = f"has several addresses on its ways to the robots ({shown}), and a node of ROS 1 announces one"
    remedy = "give each task one robot, or state ROS_IP in its env; else join the robots to one network"
    return [_build_failure(host, message, remedy, Severity.WARNING)]


def _build_failure(host: Host, message: str, remedy: str, level: Severity = Severity.FAILED) -> Finding:
    return Finding(host=host.name, check="ros", level=level, message=message, remedy=remedy)


def _diagnose_dds(host: Host, ros: RosSettings, facts: HostFacts) -> list[Finding]:
    """What the network of a host does to the discovery and the large messages of DDS."""
    seen, found = facts.ros, []
    ways = {link.interface for link in facts.links.values() if link.interface}
    deaf = [name for name in seen.no_multicast if name in ways]
    if deaf and ros.discovery_server is None:
        message = f"{deaf[0]}, the way to the robots, has no multicast: nodes do not find each other"
        found.append(
            _build_failure(host, message, "state ros: {discovery_server: ..}, or static peers in env")
        )
    if len(seen.interfaces) > 1:
        message = f"DDS announces {len(seen.interfaces)} interfaces: {', '.join(seen.interfaces)}"
        remedy = (
            f"name the one to the robots ({', '.join(sorted(ways)) or 'ip route'}) in the profile of the RMW"
        )
        found.append(_build_failure(host, message, remedy, Severity.WARNING))
    small = [
        (name, value, wanted)
        for name, value, wanted in (
            ("net.core.rmem_max", seen.receive_bytes, _RECEIVE_BYTES),
            ("net.ipv4.ipfrag_high_thresh", seen.fragment_bytes, _FRAGMENT_BYTES),
        )
        if value is not None and value < wanted
    ]
    if small:
        message = ", ".join(f"{name} is {format_bytes(value)}" for name, value, _ in small)
        remedy = " ".join(f"{name}={wanted:.0f}" for name, _, wanted in small)
        found.append(
            _build_failure(
                host,
                f"{message}: large messages are lost",
                f"on {host.name}: sudo sysctl -w {remedy}",
                Severity.WARNING,
            )
        )
    return found
