# SPDX-License-Identifier: Apache-2.0
"""Byte counters of nftables per robot address, which ``edgectl counters install`` made (ADR 104).

They see all protocols. The kernel shows them to root only: another user reads them by the one command that a
sudoers file of the installation allows. Counted are bytes as an interface counts them: IP packets with the
Ethernet header of each frame.
"""

import os
import time

from ..link import protocol
from ..link.fast_json import Document
from . import system_files
from .counters_rules import (
    NFT_PATHS,
    SCOPE_LEVELS,
    TASKS_IN,
    TASKS_OUT,
    get_rules_file,
    get_table_name,
    split_name,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from subprocess import Popen
    from typing import Dict, Iterable, Tuple

    # (packets, bytes) by (counter, address) and by (set, address, protocol, control group).
    Counts = Dict[Tuple[str, ...], Tuple[int, int]]

SUDO_PATHS = ("/usr/bin/sudo", "/bin/sudo", "/usr/local/bin/sudo")
# Part of a period that readings of the counters may cost in a resident profiler.
CPU_SHARE = 0.005
_TIMEOUT_S = 5.0
_ETHERNET_BYTES, _WITH_ETHERNET = 14, ("1", "772")
# Headers of every further frame of a packet that is cut on its way: IP and TCP with its time stamps, or a
# fragment's.
_TCP_HEADS, _OTHER_HEADS = {4: 52, 6: 72}, {4: 20, 6: 48}
# The protocol of an element, also where the host has no /etc/protocols.
_TCP_WORDS = ("tcp", "6")
# Groups of tasks in systemd: choose_scope names them.
_SCOPE_PREFIX, _SCOPE_SUFFIX = "edgectl-", ".scope"


class UnreadableError(Exception):
    """The counters cannot be read; the text says why."""


class Reading:
    """Counts at ``at`` (monotonic, s). ``tasks``: whether control groups are counted."""

    __slots__ = ("at", "counts", "tasks")

    def __init__(self, at: float, text: str) -> None:
        """``text``: the output of ``nft list table``."""
        self.at, self.counts, self.tasks = at, parse_table(text), "set %s" % TASKS_OUT in text


class Rates:
    """Bytes/s of a window.

    ``robots``: by address, ``rx``, ``tx`` and ``other``: the part of both that is not TCP. ``groups``: by
    control group and address, ``rx`` and ``tx``; ``tasks``: whether there are any. ``state``: empty without
    an installation, ``installed``, or why the counters cannot be read.
    """

    __slots__ = ("groups", "robots", "state", "tasks")

    def __init__(self, state: str = "", *, tasks: bool = False) -> None:
        self.state, self.tasks = state, tasks
        self.robots: "dict[str, Document]" = {}
        self.groups: "dict[str, dict[str, Document]]" = {}

    def covers(self, addresses: "Iterable[str]") -> bool:
        """Whether every address has counters."""
        found = list(addresses)
        return bool(found) and all(address in self.robots for address in found)

    def find_group(self, pids: "set[int]") -> "dict[str, Document] | None":
        """Find the rates of the task of these processes by address; None where it is not counted."""
        return self.get_group(find_scope(pids)) if self.tasks else None

    def get_group(self, scope: str) -> "dict[str, Document] | None":
        """Get the rates of a control group by address; None where it is not counted."""
        return self.groups.get(scope, {}) if scope and self.tasks else None


INSTALLED = protocol.COUNTERS_INSTALLED


def is_installed(fleet: str) -> bool:
    """Whether this host has rules of the fleet, in force or not."""
    return os.path.exists(get_rules_file(fleet))


def find_program(paths: "Iterable[str]") -> str:
    """Find the first of ``paths`` that can be run; empty where there is none."""
    return next((path for path in paths if os.access(path, os.X_OK)), "")


def read_counts(fleet: str) -> Reading:
    """Read all counts of the fleet. Loads the rules again where the kernel has lost them.

    Raises UnreadableError.
    """
    list_words = ["list", "table", "inet", get_table_name(fleet)]
    status, text, at = run_nft(list_words)
    if status and "No such file" in text:
        # After a reboot, or a flush of the whole rule set by a firewall.
        status, text, at = run_nft(["-f", get_rules_file(fleet)])
        status, text, at = run_nft(list_words) if not status else (status, text, at)
    if status:
        raise UnreadableError(
            text.strip().splitlines()[0][:200] if text.strip() else "nft ended with %d" % status
        )
    return Reading(at, text)


def run_nft(words: "list[str]") -> "tuple[int, str, float]":
    """Run nft, by sudo where this user is not root: (status, output, time of the first byte of it).

    The kernel's answer is printed at once, so that time is that of the reading, however long a program
    takes to start.

    Raises UnreadableError.
    """
    import subprocess

    nft = find_program(NFT_PATHS)
    if not nft:
        raise UnreadableError("nft is not installed")
    argv = [nft, *words]
    if os.geteuid() != 0:
        sudo = find_program(SUDO_PATHS)
        if not sudo:
            raise UnreadableError("sudo is not installed")
        argv = [sudo, "-n", *argv]
    try:
        with subprocess.Popen(
            argv,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=dict(os.environ, LC_ALL="C"),
        ) as run:
            at = _wait_for_output(run)
            output, _ = run.communicate()
    except OSError as error:
        raise UnreadableError("%s: %s" % (argv[0], error.strerror)) from None
    if not at:
        raise UnreadableError("no answer in %g s" % _TIMEOUT_S)
    return run.returncode, output.decode("utf-8", "replace"), at


def _wait_for_output(run: "Popen[bytes]") -> float:
    """Wait for the first byte of a program: when it came (monotonic), 0 where none did, and it is killed."""
    import select

    if run.stdout is not None and select.select([run.stdout], [], [], _TIMEOUT_S)[0]:
        return time.monotonic()
    run.kill()
    return 0.0


def parse_table(text: str) -> "Counts":
    """Parse the output of ``nft list table``, of nft 0.9 to 1.0: named counters and elements of sets."""
    found: "Counts" = {}
    name = kind = ""
    for line in text.splitlines():
        words = line.split()
        if len(words) >= 3 and words[0] in ("counter", "set") and words[2] == "{":
            kind, name = words[:2]
        elif kind == "counter" and len(words) == 4 and (words[0], words[2]) == ("packets", "bytes"):
            found[split_name(name)] = int(words[1]), int(words[3])
        elif kind == "set" and " counter packets " in line:
            found.update(_parse_elements(name, line))
        elif words == ["}"]:
            kind = kind if kind == "set" else ""
    return found


def _parse_elements(name: str, line: str) -> "Counts":
    """Parse elements of a set, of which a line may have several; the names of groups are in quotes."""
    found: "Counts" = {}
    for part in (line.partition("elements = {")[2] or line).split(", "):
        key, _, counts = part.partition(" counter packets ")
        words, fields = counts.split(), [each.strip(' "\t') for each in key.split(" . ")]
        if len(words) >= 3 and words[1] == "bytes" and len(fields) == 3:
            group = fields[2][len("unified/") :] if fields[2].startswith("unified/") else fields[2]
            found[(name, *fields[:2], group)] = int(words[0]), int(words[2].rstrip(","))
    return found


def compute_rates(before: Reading, after: Reading, mtu: "dict[str, tuple[int, int]]") -> Rates:
    """Compute the rates between two readings; ``mtu``: by address, as ``read_frame_sizes``.

    Counts that have become smaller begin again from zero.
    """
    rates, seconds = Rates(INSTALLED, tasks=after.tasks), max(1e-3, after.at - before.at)
    for key, now in after.counts.items():
        then = before.counts.get(key, (0, 0))
        packets, count = (now[0] - then[0], now[1] - then[1]) if now[0] >= then[0] else now
        kind, address = key[0], key[1]
        tcp = key[2] in _TCP_WORDS if len(key) == 4 else kind.startswith("tcp")
        value = estimate_wire_bytes(packets, count, mtu.get(address, (1500, 14)), address, tcp=tcp) / seconds
        if len(key) == 4:
            entry = rates.groups.setdefault(key[3], {}).setdefault(address, {"rx": 0.0, "tx": 0.0})
            entry["rx" if kind.startswith(TASKS_IN) else "tx"] += value
        else:
            entry = rates.robots.setdefault(address, {"rx": 0.0, "tx": 0.0, "other": 0.0})
            entry["rx" if kind.endswith("in") else "tx"] += value
            entry["other"] += 0.0 if tcp else value
    return rates


def estimate_wire_bytes(
    packets: int, count: int, frame: "tuple[int, int]", address: str, *, tcp: bool
) -> int:
    """Estimate the bytes of the frames in which ``packets`` of ``count`` bytes cross the interface.

    The counters see packets before they are cut into frames, and after those of a reception were joined. A
    share of small packets beside cut ones makes it too low, by 1.2 % at most.
    """
    mtu, link_head = frame
    heads = (_TCP_HEADS if tcp else _OTHER_HEADS)[6 if ":" in address else 4]
    frames = max(packets, -(-count // mtu))
    return count + (frames - packets) * heads + frames * link_head


def read_frame_sizes(
    addresses: "dict[str, list[str]]", interfaces: "dict[str, str | None]"
) -> "dict[str, tuple[int, int]]":
    """Read address -> (MTU, bytes of the header of each frame) of the interface to each robot."""
    return {
        address: _read_frame_size(interfaces.get(robot) or "lo")
        for robot, found in addresses.items()
        for address in found
    }


def _read_frame_size(interface: str) -> "tuple[int, int]":
    folder = "/sys/class/net/%s/" % interface
    mtu = system_files.read_text(folder + "mtu")
    kind = system_files.read_text(folder + "type")
    head = _ETHERNET_BYTES if kind in _WITH_ETHERNET or not kind else 0
    return (int(mtu) if mtu.isdigit() and int(mtu) >= 68 else 1500), head


class CounterMeter:
    """Meter of the counters since its creation or its last measurement; without an installation it costs the
    look for one file.
    """

    def __init__(self, fleet: str) -> None:
        self.fleet = fleet
        self.before: "Reading | None" = None
        self.last = Rates()
        self.cost_s = 0.0
        self._read()

    def _read(self) -> "Reading | None":
        """Read the counters; None, with the reason in ``last``, where that is not possible."""
        if not is_installed(self.fleet):
            self.before, self.last = None, Rates()
            return None
        began = _read_children_cpu_s()
        try:
            found = read_counts(self.fleet)
        except UnreadableError as error:
            self.before, self.last = None, Rates(str(error))
            return None
        self.cost_s = _read_children_cpu_s() - began
        then, self.before = self.before, found
        return then

    def measure(self, addresses: "dict[str, list[str]]", interfaces: "dict[str, str | None]") -> Rates:
        """Measure."""
        then = self._read()
        if then is not None and self.before is not None:
            self.last = compute_rates(then, self.before, read_frame_sizes(addresses, interfaces))
        return self.last

    def measure_rarely(self, addresses: "dict[str, list[str]]", interfaces: "dict[str, str | None]") -> Rates:
        """Measure as often as keeps the programs at CPU_SHARE of a core; the last rates in between."""
        spacing_s = self.cost_s / CPU_SHARE
        young = self.before is not None and time.monotonic() - self.before.at < spacing_s
        return self.last if young and self.last.robots else self.measure(addresses, interfaces)


def _read_children_cpu_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def find_scope(pids: "set[int]") -> str:
    """Find the control group in which systemd has a task and nothing else; empty without one, or where the
    rules do not look for it.
    """
    if not pids:
        return ""
    text = system_files.read_file("/proc/%d/cgroup" % min(pids)).decode("utf-8", "replace")
    path = next((line[3:] for line in text.splitlines() if line.startswith("0::")), "")
    parts = path.strip("/").split("/")
    for number, part in enumerate(parts):
        if part.startswith(_SCOPE_PREFIX) and part.endswith(_SCOPE_SUFFIX) and number + 1 in SCOPE_LEVELS:
            return "/".join(parts[: number + 1])
    return ""
