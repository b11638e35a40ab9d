# SPDX-License-Identifier: Apache-2.0
"""Wi-Fi of this host: level of the signal, repeated frames, and the access point (ADR 105).

From iw(8) where it is installed, else from /proc/net/wireless and the wireless extensions. Nothing is asked
where the host has no radio.
"""

import time

from ..link.fast_json import Document
from . import radio, radio_rate, system_files
from .sockets import socket

# ioctl SIOCGIWAP of the wireless extensions: a struct sockaddr behind the name of 16 bytes.
_GET_ACCESS_POINT = 0x8B15
_UNJOINED = ("00:00:00:00:00:00", "ff:ff:ff:ff:ff:ff", "44:44:44:44:44:44")


class RadioState:
    """Reading of one radio; None where unknown.

    ``retries`` since a start of the driver, ``access_point`` ("" where none is joined, or it is one) and
    ``joined_s`` since then.
    """

    __slots__ = ("access_point", "joined_s", "level_dbm", "retries")

    def __init__(self) -> None:
        self.level_dbm: "float | None" = None
        self.retries: "int | None" = None
        self.access_point = ""
        self.joined_s: "float | None" = None


class RadioMeter:
    """Meter of the radios between its creation or last measurement and ``measure``."""

    def __init__(self) -> None:
        self._at, self._before = time.monotonic(), read_radios()

    def measure(self) -> "dict[str, Document]":
        """Measure: interface -> what is known of its radio.

        A driver that began to count again has no retries.
        """
        since, before = self._at, self._before
        self._at, self._before = time.monotonic(), read_radios()
        seconds = max(1e-3, self._at - since)
        return {
            name: _build_entry(before.get(name, RadioState()), now, seconds)
            for name, now in self._before.items()
        }


def _build_entry(then: RadioState, now: RadioState, seconds: float) -> Document:
    known = then.retries is not None and now.retries is not None and now.retries >= then.retries
    same = then.access_point == now.access_point
    rate = (now.retries - then.retries) / seconds if known and same else None  # type: ignore[operator]
    return {
        "level_dbm": now.level_dbm,
        "retries_per_s": None if rate is None else round(rate, 2),
        "access_point": now.access_point,
        "joined_s": now.joined_s,
    }


def read_radios() -> "dict[str, RadioState]":
    """Read every radio of this host."""
    names = radio.list_radios()
    found = parse_wireless(
        system_files.read_file(radio.ROOT + "/proc/net/wireless").decode("ascii", "replace")
    )
    for name in names:
        state = found.setdefault(name, RadioState())
        text = radio_rate.run_iw("dev", name, "station", "dump")
        if text:
            parse_stations(text, state)
        if not state.access_point:
            state.access_point = _ask_access_point(name)
    return {name: found[name] for name in names}


def parse_wireless(text: str) -> "dict[str, RadioState]":
    """Parse /proc/net/wireless: its level is in dBm where it is below 0, else of a scale of the driver."""
    found: "dict[str, RadioState]" = {}
    for line in text.splitlines()[2:]:
        name, _, rest = line.partition(":")
        words = rest.split()
        if len(words) < 9:
            continue
        state = found.setdefault(name.strip(), RadioState())
        try:
            level = float(words[2].rstrip("."))
            state.retries = int(words[7])
        except ValueError:
            continue
        state.level_dbm = level if level < 0 else None
    return found


def parse_stations(text: str, state: RadioState) -> None:
    """Parse ``iw dev NAME station dump`` into ``state``; the one station of a client is its access point."""
    stations = [line.split()[1] for line in text.splitlines() if line.startswith("Station ")]
    if len(stations) != 1:
        return
    state.access_point = stations[0].lower()
    for line in text.splitlines():
        name, _, value = line.strip().partition(":")
        word = (value.split() or [""])[0]
        if name == "signal" and word.lstrip("-").isdigit():
            state.level_dbm = float(word)
        elif name == "tx retries" and word.isdigit():
            state.retries = int(word)
        elif name == "connected time" and word.isdigit():
            state.joined_s = float(word)


def _ask_access_point(name: str) -> str:
    import fcntl
    import struct

    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        request = struct.pack("=16s16x", name.encode("ascii", "replace")[:15])
        answer: bytes = fcntl.ioctl(probe.fileno(), _GET_ACCESS_POINT, request)
    except OSError:
        return ""
    finally:
        probe.close()
    address = ":".join("%02x" % each for each in answer[18:24])
    return "" if address in _UNJOINED else address
