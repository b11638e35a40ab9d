# SPDX-License-Identifier: Apache-2.0
"""Operation ``counters``: install, remove and show the byte counters of nftables for this fleet (ADR 104)."""

import os
import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..supervise import state_dir
from . import counters, network
from .counters_rules import (
    NFT_PATHS,
    OTHER_IN,
    OTHER_OUT,
    TCP_IN,
    TCP_OUT,
    build_install_script,
    build_remove_script,
)

_RATE_S = 1.0


def serve_counters(request: Document) -> Document:
    """Serve ``action``: ``install``, ``remove``, ``show``, or ``facts``, which a script of either needs.

    Raises RefusalError.
    """
    action, fleet, uid = request["action"], state_dir.get_fleet(), os.geteuid()
    addresses = network.resolve_robots(request.get("links", []))
    nft = counters.find_program(NFT_PATHS)
    if not nft:
        raise RefusalError("no-nft", "nft is not installed", "on the host: sudo apt-get install nftables")
    if action in ("install", "facts") and not any(addresses.values()):
        raise RefusalError("no-robots", "no robot has an address", "check host: of the robots")
    if action == "facts":
        return _reply(nft=nft, uid=uid, addresses=addresses)
    if action == "install":
        _run_as_root(build_install_script(fleet, addresses, nft, uid))
    elif action == "remove":
        _run_as_root(build_remove_script(fleet, nft, uid))
    return show_counters(fleet, addresses)


def _reply(**values: object) -> Document:
    return dict({"v": protocol.VERSION, "op": protocol.OP_COUNTERS}, **values)


def show_counters(fleet: str, addresses: "dict[str, list[str]]") -> Document:
    """Show state, and per robot the bytes since the installation and the rates of a second."""
    if not counters.is_installed(fleet):
        return _reply(state="", tasks=False, robots={})
    try:
        before = counters.read_counts(fleet)
        time.sleep(_RATE_S)
        after = counters.read_counts(fleet)
    except counters.UnreadableError as error:
        return _reply(state=str(error), tasks=False, robots={})
    rates = counters.compute_rates(
        before, after, counters.read_frame_sizes(addresses, network.find_interfaces(addresses))
    )
    return _reply(
        state=counters.INSTALLED,
        tasks=after.tasks,
        robots={robot: _build_robot_entry(found, after.counts, rates) for robot, found in addresses.items()},
    )


def _build_robot_entry(
    addresses: "list[str]", counts: "counters.Counts", rates: "counters.Rates"
) -> Document:
    def add_up(*names: str) -> int:
        return sum(counts.get((name, address), (0, 0))[1] for name in names for address in addresses)

    found = [rates.robots[address] for address in addresses if address in rates.robots]
    return {
        "addresses": addresses,
        "counted": rates.covers(addresses),
        "rx_bytes": add_up(TCP_IN, OTHER_IN),
        "tx_bytes": add_up(TCP_OUT, OTHER_OUT),
        "tcp_bytes": add_up(TCP_IN, TCP_OUT),
        "rx_bytes_per_s": round(sum(each["rx"] for each in found), 1),
        "tx_bytes_per_s": round(sum(each["tx"] for each in found), 1),
    }


def _run_as_root(script: str) -> None:
    """Run the script by sh, as root or by sudo without a password. Raises RefusalError."""
    import subprocess

    argv = ["/bin/sh", "-c", script]
    if os.geteuid() != 0:
        sudo = counters.find_program(counters.SUDO_PATHS)
        if not sudo:
            raise RefusalError("no-root", "this login is not root, and the host has no sudo", "")
        argv = [sudo, "-n", *argv]
    try:
        done = subprocess.run(  # noqa: UP022 - capture_output came with Python 3.7
            argv,
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=dict(os.environ, LC_ALL="C"),
            timeout=30.0,
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise RefusalError("no-counters", "the commands did not run: %s" % error, "") from None
    said = done.stdout.decode("utf-8", "replace").strip()
    if done.returncode and said.startswith("sudo:"):
        raise RefusalError("no-root", "sudo asks for a password", "")
    if done.returncode:
        raise RefusalError("no-counters", said[-500:] or "exit status %d" % done.returncode, "")
