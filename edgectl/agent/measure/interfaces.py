# SPDX-License-Identifier: Apache-2.0
"""Network interfaces of this host: bytes since boot, rates, and the speeds that their drivers state."""

from ..link.fast_json import Document
from . import radio, system_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .wireless import RadioMeter


def read_interface_bytes() -> "dict[str, tuple[int, int]]":
    """Read interface -> (bytes in, bytes out) since boot."""
    found: "dict[str, tuple[int, int]]" = {}
    for line in system_files.read_file("/proc/net/dev").decode("ascii", "replace").splitlines()[2:]:
        name, _, rest = line.partition(":")
        columns = rest.split()
        found[name.strip()] = (int(columns[0]), int(columns[8]))
    return found


def compute_rates(
    before: "dict[str, tuple[int, int]]", after: "dict[str, tuple[int, int]]", seconds: float
) -> "dict[str, dict[str, float]]":
    """Compute interface -> bytes/s in (``rx``) and out (``tx``)."""
    found = {}
    for name, now in sorted(after.items()):
        then = before.get(name, now)
        found[name] = {"rx": max(0, now[0] - then[0]) / seconds, "tx": max(0, now[1] - then[1]) / seconds}
    return found


def start_radio_meter() -> "RadioMeter | None":
    """Start the meter of the radios; None where this host has none."""
    if not radio.list_radios():
        return None
    from .wireless import RadioMeter

    return RadioMeter()


def build_interface_entry(
    rate: "dict[str, float]", speed_bytes_per_s: "int | None", wireless: "Document | None"
) -> Document:
    """Build the entry of one interface in a reply; ``wireless``: what a ``RadioMeter`` found of it."""
    entry = {
        "rx_bytes_per_s": round(rate["rx"], 1),
        "tx_bytes_per_s": round(rate["tx"], 1),
        "speed_bytes_per_s": speed_bytes_per_s,
    }
    return dict(entry, **wireless) if wireless else entry


def read_interface_speed(name: str) -> "int | None":
    """Read bytes/s; None where the driver does not know (Wi-Fi, lo): /sys has Mbit/s, -1 or nothing."""
    text = system_files.read_text("/sys/class/net/%s/speed" % name)
    return int(text) * 125000 if text.isdigit() and int(text) > 0 else None
