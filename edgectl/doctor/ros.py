"""ROS variables that do not go together: nodes on such hosts never find each other, and nothing says so."""

from collections import Counter
from collections.abc import Mapping
from urllib.parse import urlsplit

from edgectl.model.finding import Finding, HostFacts, Level
from edgectl.model.inventory import Connection, Host, Inventory, Role

MASTER, DOMAIN, RMW = "ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"
VARIABLES = (MASTER, DOMAIN, RMW)
# What ROS 2 takes where the variable is not set (the middleware: since Foxy, except Galactic).
_DEFAULTS = {MASTER: "", DOMAIN: "0", RMW: "rmw_fastrtps_cpp"}
_SELF = ("localhost", "127.0.0.1", "::1")
_SERIOUS = (MASTER, DOMAIN)

Findings = dict[str, list[Finding]]


def ros_findings(inventory: Inventory, facts: Mapping[str, HostFacts]) -> Findings:
    """Host -> its findings. Hosts of the majority are right; between equals the first of the inventory.

    A robot that sets nothing for our logins says nothing: its own software was started otherwise.
    """
    hosts = {name: host for name, host in inventory.hosts.items() if name in facts}
    found: Findings = {name: [] for name in hosts}
    for variable in VARIABLES:
        seen = {name: facts[name].surroundings.variables.get(variable, "") for name in hosts}
        for name, finding in _compared(variable, hosts, seen).items():
            found[name].append(finding)
    for name in hosts:
        if not found[name] and (text := _shown(facts[name])):
            found[name] = [Finding(host=name, check="ros", level=Level.OK, message=text)]
    return found


def _shown(facts: HostFacts) -> str:
    return ", ".join(f"{name}={value}" for name, value in facts.surroundings.variables.items() if value)


def _compared(variable: str, hosts: Mapping[str, Host], seen: Mapping[str, str]) -> dict[str, Finding]:
    if not any(seen.values()):
        return {}
    asked = {name: value or _DEFAULTS[variable] for name, value in seen.items() if value or _counts_unset(hosts[name])}
    wanted = _wanted(asked.values())
    found = {name: _mismatch(variable, hosts[name], seen[name], wanted, asked) for name, value in asked.items() if value != wanted}
    if variable == MASTER and _is_own(wanted):
        found |= _own_masters(hosts, asked)
    return found


def _counts_unset(host: Host) -> bool:
    return host.role is Role.EDGE or host.onboard


def _wanted(values: object) -> str:
    """The commonest value that is set; the first of equals."""
    counts = Counter(value for value in values if value)  # type: ignore[attr-defined]
    return str(max(counts, key=lambda value: counts[value]))


def _mismatch(variable: str, host: Host, value: str, wanted: str, asked: Mapping[str, str]) -> Finding:
    others = [name for name, other in asked.items() if other == wanted]
    has = f"is {value}" if value else f"is not set ({_DEFAULTS[variable]} by default)" if _DEFAULTS[variable] else "is not set"
    level = Level.FAILED if variable in _SERIOUS and host.role is Role.EDGE else Level.WARNING
    message = f"{variable} {has}, but {wanted} on {_listed(others)}"
    return Finding(host=host.name, check="ros", level=level, message=message, mend=_edit(variable, host, wanted))


def _listed(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _edit(variable: str, host: Host, wanted: str) -> str:
    """The prelude has the last word, where there is one."""
    if host.prelude:
        return f"in the inventory, end the prelude of {host.name} with: export {variable}={wanted}"
    return f'in the inventory, for {host.name}: env: {{{variable}: "{wanted}"}}'


def _is_own(uri: str) -> bool:
    try:
        return urlsplit(uri).hostname in _SELF
    except ValueError:
        return False


def _own_masters(hosts: Mapping[str, Host], asked: Mapping[str, str]) -> dict[str, Finding]:
    """The name localhost is another machine on each host."""
    machines = {"" if hosts[name].connection is Connection.LOCAL else name for name in asked}
    if len(machines) < 2:
        return {}
    return {
        name: Finding(
            host=name,
            check="ros",
            level=Level.FAILED if hosts[name].role is Role.EDGE else Level.WARNING,
            message=f"{MASTER} is {uri}: each host has a master of its own, and nodes of two hosts never meet",
            mend=_edit(MASTER, hosts[name], "http://ADDRESS-OF-THE-MASTER:11311"),
        )
        for name, uri in asked.items()
        if _is_own(uri)
    }
