"""The inventory file: tables of its keys, and the hosts and links that come out of it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from edgectl.config.fields import Fields, argument_vector, as_node, environment, labels, read_fields, record
from edgectl.config.node import Node
from edgectl.config.problems import Code, Problems
from edgectl.config.scalars import Read, amount, any_text, check_name, flag, integer, name, path_text, text, version, word, wrong_type
from edgectl.formats.digest import inventory_digest
from edgectl.model.inventory import Base, Capacity, Connection, Host, Inventory, Limits, Role, Runtime
from edgectl.model.order import natural_key
from edgectl.units import parse_bytes, parse_cores, parse_rate, parse_share

MAX_HOSTS = 10_000


_SHARE = amount(parse_share, above_zero=True)
LIMITS: Mapping[str, Read] = {"cpu": _SHARE, "memory": _SHARE}
CAPACITY: Mapping[str, Read] = {"cpu": amount(parse_cores, above_zero=True), "memory": amount(parse_bytes, above_zero=True)}
BASE: Mapping[str, Read] = {"cpu": amount(parse_cores), "memory": amount(parse_bytes)}
DEFAULTS: Mapping[str, Read] = {
    "connection": word(Connection),
    "port": integer(1, 65535),
    "user": path_text,
    "identity_file": text,
    "proxy_jump": path_text,
    "password_command": argument_vector,
    "labels": labels,
    "limits": record(LIMITS, Limits, "limits"),
    "env": environment,
    "env_command": argument_vector,
    "prelude": any_text,
    "runtime": word(Runtime),
}
EDGE: Mapping[str, Read] = {
    "host": path_text,
    **DEFAULTS,
    "capacity": record(CAPACITY, Capacity, "capacity", ("cpu", "memory")),
    "base": record(BASE, Base, "base"),
}
ROBOT: Mapping[str, Read] = {**EDGE, "onboard": flag, "probe": flag}
LINK: Mapping[str, Read] = {"edge": name, "robot": name, "throughput": amount(parse_rate)}


INVENTORY: Mapping[str, Read] = {"version": version, "defaults": as_node, "edges": as_node, "robots": as_node, "links": as_node}


def read_inventory(node: Node, problems: Problems) -> Inventory:
    """The inventory, with everything wrong noted; hosts that have mistakes are in it, so that tasks can refer to them."""
    top = read_fields(node, problems, INVENTORY, required=("version",), what="an inventory")
    defaults = read_fields(top.at("defaults"), problems, DEFAULTS, what="defaults").values if "defaults" in top else {}
    hosts: dict[str, Host] = {}
    for key, role in (("edges", Role.EDGE), ("robots", Role.ROBOT)):
        if key in top:
            _read_hosts(top.at(key), role, defaults, hosts, problems)
    if not hosts and not problems.errors:
        problems.add(node.mark, Code.MISSING, "the inventory names no host", "add edges: {edge1: {host: 192.168.1.20}}")
    ordered = {key: hosts[key] for key in sorted(hosts, key=natural_key)}
    links = _read_links(top.at("links"), ordered, problems) if "links" in top else {}
    digest = inventory_digest(Inventory(hosts=ordered, links=links))
    return Inventory(hosts={key: _at_home(host) for key, host in ordered.items()}, links=links, digest=digest)


def _at_home(host: Host) -> Host:
    """``~`` of the identity file expanded: after the digest, so that the same file has the same digest for every user."""
    path = host.identity_file
    return replace(host, identity_file=str(Path(path).expanduser())) if path is not None and path.startswith("~/") else host


def _read_hosts(node: Node, role: Role, defaults: Mapping[str, Any], hosts: dict[str, Host], problems: Problems) -> None:
    if not isinstance(node.value, dict):
        wrong_type(node, problems, f"{role}s must be a mapping of names", f"write {role}1: {{host: 192.168.1.20}} on a line of its own")
        return
    if len(hosts) + len(node.value) > MAX_HOSTS:
        problems.add(node.mark, Code.TOO_MANY, f"more than {MAX_HOSTS:,} hosts", "split the fleet over several inventories")
        return
    for key, inner in node.value.items():
        check_name(key, node, problems, f"{'an' if role is Role.EDGE else 'a'} {role}")
        if key in hosts:
            problems.add(
                node.key_mark(key), Code.TAKEN, f"{key} is an edge already; edges and robots share their names", "rename one of the two"
            )
            continue
        hosts[key] = _read_host(key, role, inner, defaults, problems)


def _read_host(key: str, role: Role, node: Node, defaults: Mapping[str, Any], problems: Problems) -> Host:
    what = f"{role} {key}"
    fields = read_fields(node, problems, EDGE if role is Role.EDGE else ROBOT, what=what)
    values = {**defaults, **fields.values}
    for mapping in ("labels", "env"):
        values[mapping] = {**defaults.get(mapping, {}), **fields.values.get(mapping, {})}
    if "limits" in defaults and "limits" in fields.values:
        values["limits"] = _merged_limits(fields, defaults["limits"])
    local = values.get("connection") is Connection.LOCAL
    if "host" not in fields and isinstance(node.value, dict) and not local:
        problems.add(node.mark, Code.MISSING, f"{what} needs host", "add host: 192.168.1.20 (an address or an ssh_config alias)")
    _contradictions(fields, problems)
    return Host(name=key, role=role, **({"host": "127.0.0.1" if local else ""} | values))


def _merged_limits(fields: Fields, default: Limits) -> Limits:
    own: Limits = fields.values["limits"]
    stated = fields.at("limits").value
    changed = {key: getattr(own, key) for key in LIMITS if isinstance(stated, dict) and key in stated}
    return replace(default, **changed)


def _contradictions(fields: Fields, problems: Problems) -> None:
    if "base" in fields and "capacity" not in fields:
        message = "base counts only on a slice, and this host declares no capacity"
        problems.add(fields.node.key_mark("base"), Code.CONTRADICTION, message, "add capacity: {cpu: .., memory: ..}, or remove base")
    if fields.values.get("onboard") and fields.values.get("probe") is False:
        message = "a robot with probe: false is never contacted, so it cannot run its own tasks"
        problems.add(fields.node.key_mark("onboard"), Code.CONTRADICTION, message, "remove onboard: true or probe: false")


def _read_links(node: Node, hosts: Mapping[str, Host], problems: Problems) -> dict[tuple[str, str], float]:
    if not isinstance(node.value, list):
        wrong_type(node, problems, "links must be a list", "write - {edge: edge1, robot: robot1, throughput: 54Mbit/s}")
        return {}
    links: dict[tuple[str, str], float] = {}
    for inner in node.value:
        fields = read_fields(inner, problems, LINK, required=tuple(LINK), what="a link")
        ends = [_end(fields, role, hosts, problems) for role in Role]
        if None in ends or "throughput" not in fields.values:
            continue
        pair = (str(ends[0]), str(ends[1]))
        if pair in links:
            problems.add(inner.mark, Code.TAKEN, f"the link of {pair[0]} and {pair[1]} is declared twice", "remove one of the two")
        links[pair] = fields.values["throughput"]
    return dict(sorted(links.items(), key=lambda item: (natural_key(item[0][0]), natural_key(item[0][1]))))


def _end(fields: Fields, role: Role, hosts: Mapping[str, Host], problems: Problems) -> str | None:
    wanted = fields.values.get(role.value)
    if wanted is None or (wanted in hosts and hosts[wanted].role is role):
        return wanted
    known = [host.name for host in hosts.values() if host.role is role]
    problems.add(
        fields.at(role.value).mark, Code.UNKNOWN_NAME, f"unknown {role} {wanted}", problems.did_you_mean(wanted, known, f"the {role}s are")
    )
    return None
