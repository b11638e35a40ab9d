# SPDX-License-Identifier: Apache-2.0
"""Compose file as a task file: each service becomes a task with an image."""

import re
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from edgectl.config.node import Node, value_from_node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.importers.launch_values import Launch
from edgectl.importers.ros_tasks import EMPTY_EDGE, ImportedFiles, to_host_name
from edgectl.importers.yaml_text import FileEntry, FileText

Values = dict[str, Any]
MERGE_KEY = "<<"
_VARIABLE = re.compile(
    r"\$(?:(?P<dollar>\$)|(?P<plain>[A-Za-z_]\w*)|\{(?P<name>[A-Za-z_]\w*)(?:(?P<how>:?[-?+])(?P<word>[^{}]*))?\})"
)
_DURATION = re.compile(r"(?:\d+(?:\.\d+)?(?:us|ms|s|m|h))+")
_BYTES = re.compile(r"(\d+(?:\.\d+)?)\s*([bkmgt]?)b?", re.IGNORECASE)
_UNTIL = {
    "service_started": "running",
    "service_healthy": "ready",
    "service_completed_successfully": "completed",
}
_RESTART = {"always": "always", "unless-stopped": "always", "on-failure": "on-failure", "no": "never"}
_PULL = {"always": "always", "never": "never", "missing": "missing", "if_not_present": "missing"}
# Keys of a service that are options of docker create, for each entry or as they are.
_OPTIONS = {
    "cap_add": "--cap-add", "cap_drop": "--cap-drop", "security_opt": "--security-opt",
    "group_add": "--group-add", "tmpfs": "--tmpfs", "extra_hosts": "--add-host", "dns": "--dns",
    "shm_size": "--shm-size", "runtime": "--runtime", "hostname": "--hostname", "cpuset": "--cpuset-cpus",
}  # fmt: skip
_FLAGS = {"privileged": "--privileged", "read_only": "--read-only"}
# Keys that say nothing to edgectl, or what it does by itself.
_SILENT = frozenset(("container_name", "init", "labels", "tty", "stdin_open", "logging", "attach"))
_READ = frozenset(
    ("image", "command", "entrypoint", "environment", "volumes", "devices", "user", "network_mode", "ipc",
     "depends_on", "healthcheck", "restart", "stop_signal", "stop_grace_period", "working_dir", "deploy",
     "cpus", "mem_limit", "mem_reservation", "gpus", "pull_policy", "build")
)  # fmt: skip
_DEPLOY_READ = frozenset(("resources", "restart_policy", "labels"))


def build_compose_tasks(
    root: Node, title: str, fleet: str, env: Mapping[str, str], problems: Problems, notes: Launch
) -> ImportedFiles:
    """The task file and the inventory of this machine; problems are collected.

    ``env``: values of the variables of the file.
    """
    services = root.value.get("services") if isinstance(root.value, dict) else None
    if services is None or not isinstance(services.value, dict):
        hint = "name a compose file, whose services: is a mapping"
        problems.add(root.mark, ProblemCode.MISSING, "the file has no services", hint)
        return ImportedFiles(inventory=FileText(comments=()), tasks=FileText(comments=()))
    for key in root.value if isinstance(root.value, dict) else ():
        if key not in ("services", "version", "name") and not key.startswith("x-"):
            notes.note(root.key_mark(key), f"{key} of the file is not imported")
    found = {name: _fill(_merge(node), env, notes) for name, node in services.value.items()}
    jobs = {other for node in found.values() for other, until in _list_needs(node) if until == "completed"}
    entries = [
        FileEntry(
            name=to_host_name(name),
            values=_build_task(name, node, found, problems, notes)
            | ({"kind": "job"} if name in jobs else {}),
        )
        for name, node in found.items()
    ]
    about = f"Imported from {title}."
    edge = FileEntry(
        name=EMPTY_EDGE,
        values={"connection": "local"},
        comments=("This machine. Write the edges of the lab instead.",),
    )
    inventory = FileText(comments=(about,), keys={"version": 1, "fleet": fleet}, sections={"edges": [edge]})
    tasks = FileText(comments=(about,), keys={"version": 1}, sections={"tasks": entries})
    return ImportedFiles(inventory=inventory, tasks=tasks)


def _merge(node: Node) -> Node:
    """The value with its merge keys resolved: what is stated beside them wins, then the first of several."""
    if isinstance(node.value, list):
        return Node([_merge(inner) for inner in node.value], node.mark, keys=node.keys, size=node.size)
    if not isinstance(node.value, dict):
        return node
    entries = {key: _merge(inner) for key, inner in node.value.items() if key != MERGE_KEY}
    keys = dict(node.keys)
    source = node.value.get(MERGE_KEY)
    given = source.value if source is not None and isinstance(source.value, list) else [source]
    for each in given:
        merged = _merge(each) if each is not None else None
        if merged is not None and isinstance(merged.value, dict):
            entries = {**merged.value, **entries}
            keys = {**merged.keys, **keys}
    return Node(entries, node.mark, node.text, keys, node.size)


def _fill(node: Node, env: Mapping[str, str], notes: Launch) -> Node:
    """The value with the variables of the file filled in; each is named, because its value is fixed then."""
    if isinstance(node.value, dict):
        inner = {key: _fill(each, env, notes) for key, each in node.value.items()}
        return Node(inner, node.mark, node.text, node.keys, node.size)
    if isinstance(node.value, list):
        return Node(
            [_fill(each, env, notes) for each in node.value], node.mark, node.text, node.keys, node.size
        )
    if not isinstance(node.value, str) or "$" not in node.value:
        return node

    def replace(match: re.Match[str]) -> str:
        if match["dollar"]:
            return "$"
        name, how, word = match["plain"] or match["name"], match["how"] or "", match["word"] or ""
        value = env.get(name)
        known = bool(value) if how.startswith(":") else value is not None
        if how.endswith("+"):
            return word if known else ""
        if known:
            notes.note(node.mark, f"${name} is fixed as {value!r}, its value here")
            return value or ""
        if not how.endswith("-"):
            notes.note(node.mark, f"${name} has no value here", f"export {name}, or edit the task file")
        return word if how.endswith("-") else ""

    return Node(_VARIABLE.sub(replace, node.value), node.mark, node.text, node.keys, node.size)


def _build_task(
    name: str, node: Node, services: Mapping[str, Node], problems: Problems, notes: Launch
) -> Values:
    if not isinstance(node.value, dict):
        problems.add(
            node.mark, ProblemCode.TYPE, f"service {name} must be a mapping", "write image: NAME below it"
        )
        return {}
    stated: Values = {key: value_from_node(each) for key, each in node.value.items()}
    for key in stated:
        if not (key in _READ or key in _SILENT or key in _OPTIONS or key in _FLAGS or key.startswith("x-")):
            notes.note(node.key_mark(key), f"{name}: {key} is not imported")
    values: Values = {"image": _build_image(name, node, stated, notes)}
    command = _join_command(stated.get("entrypoint"), stated.get("command"))
    if command:
        values["command"] = command
    needs = [_build_need(node, other, until, services, problems) for other, until in _list_needs(node)]
    if needs:
        values["needs"] = [need for need in needs if need]
    values |= _build_amounts(stated)
    values |= _build_check(name, node, stated.get("healthcheck"), notes)
    env = _read_environment(name, node, stated.get("environment"), notes)
    if env:
        values["env"] = env
    if stated.get("working_dir"):
        values["workdir"] = stated["working_dir"]
    stop = _build_stop(stated)
    if stop:
        values["stop"] = stop
    restart = str(stated.get("restart", "no" if "restart" in stated else "")).partition(":")[0]
    if restart in _RESTART:
        values["restart"] = _RESTART[restart]
    _note_deploy(name, node, stated, notes)
    return values


def _build_image(name: str, node: Node, stated: Values, notes: Launch) -> object:
    if "image" not in stated:
        notes.note(
            node.mark, f"{name} has no image: build it, and write its name", f"docker build -t {name} .."
        )
    elif "build" in stated:
        notes.note(node.key_mark("build"), f"{name}: build is not imported; hosts pull {stated['image']}")
    image: Values = {"name": str(stated.get("image") or to_host_name(name))}
    gpus = _count_gpus(stated)
    volumes = list(_list_volumes(name, node, stated.get("volumes"), notes))
    devices = [str(each) for each in _as_list(stated.get("devices"))]
    pull = _PULL.get(str(stated.get("pull_policy")))
    options = list(_list_options(stated))
    for key, value in (
        ("gpus", gpus),
        ("devices", devices),
        ("volumes", volumes),
        ("pull", pull),
        ("args", options),
    ):
        if value:
            image[key] = value
    if stated.get("user") is not None:
        image["user"] = str(stated["user"])
    for key, mode in (("network", stated.get("network_mode")), ("ipc", stated.get("ipc"))):
        if mode not in (None, "host"):
            image[key] = str(mode)
    return image if len(image) > 1 else image["name"]


def _count_gpus(stated: Values) -> object:
    """``all``, how many, or None."""
    if stated.get("gpus") == "all" or stated.get("runtime") == "nvidia":
        return "all"
    devices = _as_list(_get_inner(stated, "deploy", "resources", "reservations", "devices"))
    for each in [*devices, *_as_list(stated.get("gpus"))]:
        if isinstance(each, dict) and "gpu" in _as_list(each.get("capabilities", ["gpu"])):
            count = each.get("count", len(_as_list(each.get("device_ids"))) or "all")
            return "all" if count in ("all", -1) else int(count)
    return None


def _list_volumes(name: str, node: Node, given: object, notes: Launch) -> Iterator[str]:
    for each in _as_list(given):
        text = each if isinstance(each, str) else ""
        if isinstance(each, dict) and each.get("type", "volume") in ("bind", "volume") and each.get("source"):
            text = f"{each['source']}:{each.get('target', '')}" + (":ro" if each.get("read_only") else "")
        if not text or ":" not in text or text.startswith("."):
            shown = text or str(each)
            hint = "write its absolute path on the hosts"
            notes.note(node.key_mark("volumes"), f"{name}: the volume {shown} is not imported", hint)
            continue
        yield text


def _list_options(stated: Values) -> Iterator[str]:
    for key, option in _OPTIONS.items():
        if key == "runtime" and stated.get(key) == "nvidia":
            continue
        given = stated.get(key)
        entries = (
            [f"{host}:{to}" for host, to in given.items()] if isinstance(given, dict) else _as_list(given)
        )
        yield from (f"{option}={entry}" for entry in entries)
    yield from (flag for key, flag in _FLAGS.items() if stated.get(key) is True)


def _join_command(entrypoint: object, command: object) -> str:
    """The words of both as one line of a shell."""
    parts = [
        each if isinstance(each, str) else shlex.join(map(str, _as_list(each)))
        for each in (entrypoint, command)
    ]
    return " ".join(part.strip() for part in parts if part)


def _list_needs(node: Node) -> list[tuple[str, str]]:
    """(service, state) that a service waits for."""
    stated = value_from_node(node)
    given = stated.get("depends_on") if isinstance(stated, dict) else None
    if isinstance(given, dict):
        return [
            (str(name), _UNTIL.get(str(_get_inner(how, "condition")), "running"))
            for name, how in given.items()
        ]
    return [(str(name), "running") for name in _as_list(given)]


def _build_need(
    node: Node, other: str, until: str, services: Mapping[str, Node], problems: Problems
) -> object:
    if other not in services:
        mark = node.key_mark("depends_on")
        hint = problems.did_you_mean(other, services)
        problems.add(mark, ProblemCode.UNKNOWN_NAME, f"{other} is no service of the file", hint)
        return None
    return to_host_name(other) if until == "ready" else {"task": to_host_name(other), "until": until}


def _build_amounts(stated: Values) -> Values:
    """Reservations as the demand, limits as limits."""
    reserved = _get_inner(stated, "deploy", "resources", "reservations") or {}
    limits = _get_inner(stated, "deploy", "resources", "limits") or {}
    demand = {"cpu": reserved.get("cpus"), "memory": reserved.get("memory", stated.get("mem_reservation"))}
    caps = {
        "cpu": limits.get("cpus", stated.get("cpus")),
        "memory": limits.get("memory", stated.get("mem_limit")),
    }
    known = {key: _convert_amount(key, value) for key, value in demand.items() if value is not None}
    bound = {key: _convert_amount(key, value) for key, value in caps.items() if value is not None}
    return {"demand": known or "measured"} | ({"limits": bound} if bound else {})


def _convert_amount(key: str, value: object) -> object:
    """Cores as a number, bytes in binary units: Compose means 1024 by k."""
    if key == "cpu":
        number = float(str(value)) if re.fullmatch(r"\d+(\.\d+)?", str(value)) else 0.0
        return int(number) if number.is_integer() else number
    found = _BYTES.fullmatch(str(value).strip())
    unit = found[2].upper() if found is not None else ""
    return str(value) if found is None else f"{found[1]}{unit + 'i' if unit and unit != 'B' else ''}"


def _build_check(name: str, node: Node, given: object, notes: Launch) -> Values:
    if not isinstance(given, dict) or given.get("disable") is True:
        return {}
    test = given.get("test")
    words = [str(word) for word in _as_list(test)]
    if isinstance(test, str):
        asked = ["sh", "-c", test]
    elif words[:1] == ["CMD-SHELL"]:
        asked = ["sh", "-c", " ".join(words[1:])]
    else:
        asked = words[1:] if words[:1] == ["CMD"] else []
    if not asked:
        return {}
    if given.keys() - {"test"}:
        message = f"{name}: of healthcheck only the test is imported, as ready"
        notes.note(node.key_mark("healthcheck"), message)
    # Compose asks in the container, and edgectl on the host.
    return {"ready": {"command": f'docker exec "$EDGECTL_CONTAINER" {shlex.join(asked)}'}}


def _read_environment(name: str, node: Node, given: object, notes: Launch) -> dict[str, str]:
    pairs = (
        given.items()
        if isinstance(given, dict)
        else (str(each).partition("=")[::2] for each in _as_list(given))
    )
    env = {}
    for key, value in pairs:
        if value is None or (isinstance(given, list) and str(key) in given):
            notes.note(
                node.key_mark("environment"), f"{name}: {key} is not imported: it has no value in the file"
            )
            continue
        env[str(key)] = str(value).lower() if isinstance(value, bool) else str(value)
    return env


def _build_stop(stated: Values) -> Values:
    stop = {}
    if stated.get("stop_signal"):
        stop["signal"] = str(stated["stop_signal"]).removeprefix("SIG")
    grace = str(stated.get("stop_grace_period", ""))
    if _DURATION.fullmatch(grace):
        stop["grace"] = grace
    return stop


def _note_deploy(name: str, node: Node, stated: Values, notes: Launch) -> None:
    deploy = stated.get("deploy")
    for key in deploy if isinstance(deploy, dict) else ():
        if key not in _DEPLOY_READ:
            notes.note(node.key_mark("deploy"), f"{name}: {key} of deploy is not imported")


def _get_inner(value: object, *keys: str) -> Any:  # noqa: ANN401
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _as_list(value: object) -> list[Any]:
    if value is None or isinstance(value, dict):
        return []
    return value if isinstance(value, list) else [value]
