# SPDX-License-Identifier: Apache-2.0
"""Operation ``doctor``: facts about this host that may cause trouble; the manager judges them.

``root`` is another tree in tests.
"""

import os
import sys
import time

from ..link import boot, protocol
from ..link.fast_json import Document
from ..ros import facts, local
from ..supervise import logind, scope, shell, state_dir
from . import device, interfaces, network, system_files

ROS_VARIABLES = ("ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION")
_CONNECT_S = 1.0
_MARK = "edgectl-sees:"
# User ids that logind counts as people's; of all others it removes nothing.
_MIN_PERSON_UID, _NOBODY_UID = 1000, 65534


def collect_facts(request: Document) -> Document:
    """Collect the facts without changing anything."""
    began, wall = time.monotonic(), time.time()
    shell.install_deadline_handlers()
    hardware = device.start_hardware_meter()
    request = local.fill_request(dict(request, command=""))
    ros = request.get("ros") or {"setup": []}
    missing = facts.find_missing_files(ros)
    env = dict(request.get("env") or {}, EDGECTL_PACKAGES=" ".join(request.get("packages") or []))
    seen = shell.ShellCommand(
        _build_script(request.get("prelude", "")),
        "",
        env,
        float(request.get("timeout_s", 8.0)),
        None,
        [path for path in ros["setup"] if path not in missing],
    )
    addresses = network.resolve_robots(request.get("links", []))
    probes = network.ConnectProbes(addresses)
    _wait_for_answers(probes, addresses)
    answer = {
        "v": protocol.VERSION,
        "op": protocol.OP_DOCTOR,
        "host": request["host"],
        "python": "%d.%d.%d" % sys.version_info[:3],
        "psutil": device.find_psutil_folder() is not None,
        "machine": {
            "boot_id": system_files.read_boot_id(),
            "machine_id": system_files.read_machine_id(),
            "pid_namespace": system_files.read_pid_namespace(),
        },
        "logind": read_login_facts(),
        "disk": dict(
            read_disk_facts(state_dir.BASES[0]),
            spare=not read_disk_facts(state_dir.BASES[-1])["obstacle"],
            skipped=[base for base in state_dir.BASES if state_dir.is_foreign_base(base)],
        ),
        "memory": device.read_memory(),
        "hardware": _collect_hardware(device.measure_hardware(hardware)),
        "links": {robot: _build_link_facts(found, robot, probes) for robot, found in addresses.items()},
    }
    if request.get("engines"):
        from ..containers.engine import describe_engines

        answer["engines"] = describe_engines()
    if request.get("managers") is not None:
        from ..containers.swarm import describe_swarm

        answer["engines"].update(describe_swarm(request["managers"]))
    result = seen.result()
    answer["surroundings"] = parse_surroundings(result)
    if request.get("ros"):
        answer["ros"] = dict(
            facts.read_ros_facts(ros, request.get("links", [])),
            missing_packages=_parse_missing_packages(result),
        )
    seconds = time.monotonic() - began
    return dict(answer, clock={"began": wall, "ended": wall + seconds})


def _collect_hardware(found: Document) -> Document:
    """Collect the readings of what few hosts have, and the temperature."""
    readings: Document = {"temperature_c": device.read_temperature_c()}
    for each in found.values():
        readings.update(each if isinstance(each, dict) else {})
    return readings


def _wait_for_answers(probes: network.ConnectProbes, addresses: "dict[str, list[str]]") -> None:
    """Wait until every robot has answered, at most a second."""
    deadline = time.monotonic() + _CONNECT_S
    while time.monotonic() < deadline and any(
        found and probes.reachable[robot] is None for robot, found in addresses.items()
    ):
        probes.wait(time.monotonic() + 0.02)
    probes.close(addresses)


def _build_link_facts(found: "list[str]", robot: str, probes: network.ConnectProbes) -> Document:
    interface = network.find_interface(found[0]) if found else None
    return {
        "found": bool(found),
        "reachable": probes.reachable.get(robot),
        "rtt_ms": probes.rtt_ms.get(robot),
        "interface": interface,
        "speed_bytes_per_s": interfaces.read_interface_speed(interface) if interface else None,
    }


def read_login_facts(root: str = "") -> Document:
    """Read the effects of a logout on this user's processes and shared memory."""
    user, person = scope.get_user_name(), _MIN_PERSON_UID <= os.geteuid() < _NOBODY_UID
    return {
        "user": user,
        "present": logind.is_logind_present(root),
        "lingers": scope.is_lingering(user, root),
        "removes_ipc": (person or bool(root)) and logind.removes_ipc(root),
        "kills": (os.geteuid() != 0 or bool(root)) and logind.kills_users_processes(root),
    }


def read_disk_facts(path: str) -> Document:
    """Read the file system of ``path``, existing or not, and what prevents its use as a private directory."""
    there = path
    while not os.path.lexists(there) and there != "/":
        there = os.path.dirname(there)
    found = os.statvfs(there)
    return {
        "path": path,
        "free_bytes": found.f_bavail * found.f_frsize,
        "total_bytes": found.f_blocks * found.f_frsize,
        "files_left": found.f_favail if found.f_files else None,
        "obstacle": _find_obstacle(path, there),
    }


def _find_obstacle(path: str, there: str) -> str:
    if os.path.islink(there) or not os.path.isdir(there):
        return protocol.NO_DIRECTORY
    if path != there:
        return "" if os.access(there, os.W_OK | os.X_OK) else "%s is not writable" % there
    try:
        boot.check_private_dir(path)
    except OSError as error:
        return error.strerror or str(error)
    return "" if os.access(path, os.W_OK | os.X_OK) else "it is not writable"


def _build_script(prelude: str) -> str:
    """Build a script: the prelude, its status, and the exported variables as a child process (a task) sees
    them.
    """
    show = " ".join('"%s=$%s"' % (name, name) for name in ROS_VARIABLES)
    return "%s\nset -- $?\necho\necho '%s' $1\n/bin/sh -c 'printf \"%%s\\n\" %s'\n%s" % (
        prelude,
        _MARK,
        show,
        facts.FIND_PACKAGES,
    )


def parse_surroundings(result: Document) -> Document:
    """Parse the output of the script: the last mark counts, whatever the prelude prints before it."""
    before, mark, after = result["output"].rpartition("\n%s " % _MARK)
    said = [line for line in (before if mark else after).splitlines() if line.strip()]
    status, *lines = after.splitlines() if mark else ["", ""]
    found = dict(line.split("=", 1) for line in lines if "=" in line)
    return {
        "status": int(status) if status.strip().isdigit() else None,
        "timed_out": result["timed_out"],
        "said": said[-1][-200:] if said else "",
        "variables": {name: found.get(name, "") for name in ROS_VARIABLES},
    }


def _parse_missing_packages(result: Document) -> "list[str]":
    """Parse the packages that the script did not find; none where it did not come so far."""
    for line in str(result["output"]).splitlines():
        name, _, value = line.partition("=")
        if name == facts.PACKAGES_VARIABLE:
            return value.split()
    return []
