"""Operation ``doctor``: what may go wrong on this host, as facts; the manager judges them. ``root`` is for tests."""

import os
import sys
import time

from . import boot, device, logind, network, scope, shell, state

VARIABLES = ("ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION")
_KNOCK_S = 1.0
_NO_DIRECTORY = "something that is no directory stands there"
_MARK = "edgectl-sees:"
# Ids that logind takes for those of people; of all others it removes nothing.
_FIRST_PERSON, _NOBODY = 1000, 65534


def doctor(request: dict) -> dict:
    """Look around; nothing is changed."""
    began, wall = time.monotonic(), time.time()
    shell.guard()
    seen = shell.Command(
        _script(request.get("prelude", "")), "", request.get("env"), float(request.get("timeout_s", 8.0))
    )
    addresses = network.resolve(request.get("links", []))
    knocks = network.Knocks(addresses)
    _await(knocks, addresses)
    psutil = device.find_psutil()
    answer = {
        "v": 1,
        "op": "doctor",
        "host": request["host"],
        "python": "%d.%d.%d" % sys.version_info[:3],
        "psutil": psutil is not None,
        "logind": login_end(),
        "disk": dict(disk(state.BASES[0]), spare=not disk(state.BASES[-1])["obstacle"]),
        "memory": device.memory(psutil),
        "links": {robot: _link(found, robot, knocks) for robot, found in addresses.items()},
        "surroundings": surroundings(seen.result()),
    }
    seconds = time.monotonic() - began
    return dict(answer, clock={"began": wall, "ended": wall + seconds})


def _await(knocks, addresses: dict) -> None:
    """Until every robot has answered, at most a second."""
    deadline = time.monotonic() + _KNOCK_S
    while time.monotonic() < deadline and any(
        found and knocks.reachable[robot] is None for robot, found in addresses.items()
    ):
        knocks.wait(time.monotonic() + 0.02)
    knocks.close(addresses)


def _link(found: list, robot: str, knocks) -> dict:
    interface = network.interface_to(found[0]) if found else None
    return {
        "found": bool(found),
        "reachable": knocks.reachable.get(robot),
        "rtt_ms": knocks.rtt_ms.get(robot),
        "interface": interface,
        "speed_bytes_per_s": network.speed(interface) if interface else None,
    }


def login_end(root: str = "") -> dict:
    """What becomes of this user's processes and shared memory when the last login ends."""
    user, person = scope.user_name(), _FIRST_PERSON <= os.geteuid() < _NOBODY
    return {
        "user": user,
        "present": logind.is_present(root),
        "lingers": scope.lingers(user, root),
        "removes_ipc": (person or bool(root)) and logind.removes_ipc(root),
        "kills": (os.geteuid() != 0 or bool(root)) and logind.kills_users_processes(root),
    }


def disk(path: str) -> dict:
    """The file system on which ``path`` lies or would lie, and what keeps us from using it as a private directory."""
    there = path
    while not os.path.lexists(there) and there != "/":
        there = os.path.dirname(there)
    found = os.statvfs(there)
    return {
        "path": path,
        "free_bytes": found.f_bavail * found.f_frsize,
        "total_bytes": found.f_blocks * found.f_frsize,
        "files_left": found.f_favail if found.f_files else None,
        "obstacle": _obstacle(path, there),
    }


def _obstacle(path: str, there: str) -> str:
    if os.path.islink(there) or not os.path.isdir(there):
        return _NO_DIRECTORY
    if path != there:
        return "" if os.access(there, os.W_OK | os.X_OK) else "%s cannot be written" % there
    try:
        boot.check_private(path)
    except OSError as error:
        return error.strerror
    return "" if os.access(path, os.W_OK | os.X_OK) else "it cannot be written"


def _script(prelude: str) -> str:
    """The prelude, its status, and the exported variables as a child sees them: what a task would see."""
    show = " ".join('"%s=$%s"' % (name, name) for name in VARIABLES)
    return "%s\nset -- $?\necho\necho '%s' $1\n/bin/sh -c 'printf \"%%s\\n\" %s'" % (prelude, _MARK, show)


def surroundings(result: dict) -> dict:
    """What the script said: the last mark counts, whatever the prelude prints before."""
    before, mark, after = result["output"].rpartition("\n%s " % _MARK)
    said = [line for line in (before if mark else after).splitlines() if line.strip()]
    status, *lines = after.splitlines() if mark else ["", ""]
    found = dict(line.split("=", 1) for line in lines if "=" in line)
    return {
        "status": int(status) if status.strip().isdigit() else None,
        "timed_out": result["timed_out"],
        "said": said[-1][-200:] if said else "",
        "variables": {name: found.get(name, "") for name in VARIABLES},
    }
