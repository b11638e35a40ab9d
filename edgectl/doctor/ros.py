"""Checks of ROS variables that differ between hosts: their nodes never find each other, without an error."""

from collections import Counter
from collections.abc import Mapping
from urllib.parse import urlsplit

from edgectl.model.diagnosis import Finding, HostFacts, Severity
from edgectl.model.inventory import Connection, Host, Inventory, Role

MASTER, DOMAIN, RMW = "ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"
ROS_VARIABLES = (MASTER, DOMAIN, RMW)
# The value in ROS 2 where the variable is not set (the middleware: since Foxy, except Galactic).
_DEFAULTS = {MASTER: "", DOMAIN: "0", RMW: "rmw_fastrtps_cpp"}
_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
_FATAL_VARIABLES = (MASTER, DOMAIN)

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
    for name in hosts:
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
