# SPDX-License-Identifier: Apache-2.0
"""Bit rate of the radios of this host, as their drivers state it.

It is a nominal rate, above what TCP gets, and a live one: drivers lower it with the quality of the signal.
"""

import os

from .radio import select_radios

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

# ioctl SIOCGIWRATE of the wireless extensions; struct iwreq is a name of 16 bytes and a struct iw_param.
_GET_RATE = 0x8B21
_IW_TIMEOUT_S = 1.0


def read_rates(wanted: "Iterable[str | None]") -> "dict[str | None, float]":
    """Read bytes/s by interface, of those ``wanted`` that are radios and state a rate."""
    names = sorted(name for name in set(wanted) if name is not None and name != "lo")
    found = {name: _read_rate(name) for name in (select_radios(names) if names else ())}
    return {name: rate for name, rate in found.items() if rate}


def _read_rate(name: str) -> float:
    return _ask_driver(name) or parse_iw_link(run_iw("dev", name, "link"))


def _ask_driver(name: str) -> float:
    """Ask by ioctl, which starts no process; 0 where the kernel has no wireless extensions."""
    # Few hosts get here, and each library that a probe loads costs it 0.2 ms.
    import fcntl
    import struct

    from .sockets import socket

    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        request = struct.pack("=16s16x", name.encode("ascii", "replace")[:15])
        answer: bytes = fcntl.ioctl(probe.fileno(), _GET_RATE, request)
    except OSError:
        return 0.0
    finally:
        probe.close()
    return float(max(0, struct.unpack_from("=i", answer, 16)[0])) / 8.0


def run_iw(*words: str) -> str:
    """Run iw(8); empty where it is not installed or fails."""
    import subprocess

    path = os.environ.get("PATH", "/usr/bin:/bin") + ":/usr/sbin:/sbin"
    try:
        done = subprocess.run(  # noqa: UP022 - capture_output came with Python 3.7
            ["iw", *words],
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=dict(os.environ, PATH=path),
            timeout=_IW_TIMEOUT_S,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.decode("utf-8", "replace")


def parse_iw_link(text: str) -> float:
    """Parse ``iw dev NAME link``: bytes/s of ``tx bitrate: 144.4 MBit/s ..``, 0 where there is none."""
    for line in text.splitlines():
        words = line.split()
        if words[:2] == ["tx", "bitrate:"] and len(words) > 3 and words[3] == "MBit/s":
            try:
                return float(words[2]) * 125000.0
            except ValueError:
                return 0.0
    return 0.0
