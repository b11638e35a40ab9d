# SPDX-License-Identifier: Apache-2.0
"""Hardware that few hosts have: GPU, sensors of power, battery.

GPU: the load file of a Jetson, whose GPU shares the memory of the host, else ``nvidia-smi``, which unlike a
call into the driver's library cannot end the agent. Power: the input rail of a Jetson, else a battery that is
discharging, else the sum of processor packages (RAPL), sensors and graphics cards.
"""

import os
import time

from . import system_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Callable

# Of JetPack 4; later ones have the sensor among those of hwmon.
_INA_FOLDER = "/sys/bus/i2c/drivers/ina3221x"
# A reading of a counter over less says nothing.
_MIN_SECONDS = 0.04
_NVIDIA_COLUMNS = "utilization.gpu,memory.used,memory.total,power.draw"


class HardwareMeter:
    """Meter of GPU, power and battery; the power of processors is that since the last measurement."""

    def __init__(
        self, root: str, gpus: "list[str]", read_memory: "Callable[[], tuple[int, int]]", has_tool: bool
    ) -> None:
        """``gpus``: folders of a Jetson's; ``read_memory``: of the host; ``has_tool``: of NVIDIA's driver."""
        self.root, self.gpus, self.read_memory, self.has_tool = root, gpus, read_memory, has_tool
        self.start = time.monotonic(), _read_package_energies(root)

    def measure(self) -> "dict[str, Any]":
        """Measure ``gpu_share`` (None without a GPU), and under the names of the resources what is there."""
        (since, before), self.start = self.start, (time.monotonic(), _read_package_energies(self.root))
        packages = _compute_watts(before, self.start[1], self.start[0] - since)
        found, card_watts = self._read_gpu()
        watts = read_power(self.root, packages + card_watts)
        if watts is not None:
            found["power"] = {"used_watts": round(watts, 3)}
        used = read_used_charge(self.root)
        if used is not None:
            found["battery"] = {"full_charge": 1.0, "used_charge": round(used, 4)}
        gpu = found.get("gpu")
        found["gpu_share"] = None if gpu is None else min(1.0, gpu["used_gpus"] / gpu["gpus"])
        return found

    def _read_gpu(self) -> "tuple[dict[str, Any], list[float]]":
        """Read (number, use and memory of the GPUs; empty without any, the watts of each card)."""
        for text in [system_files.read_text(path + "/load") for path in self.gpus]:
            if text.isdigit():
                total, used = self.read_memory()
                return {
                    "gpu": {"gpus": 1.0, "used_gpus": min(1.0, int(text) / 1000.0)},
                    "gpu_memory": {"gpu_total_bytes": total, "gpu_used_bytes": used},
                }, []
        return _read_nvidia() if self.has_tool else ({}, [])


def _read_nvidia() -> "tuple[dict[str, Any], list[float]]":
    import subprocess

    argv = ["nvidia-smi", "--query-gpu=" + _NVIDIA_COLUMNS, "--format=csv,noheader,nounits"]
    try:
        text = subprocess.check_output(argv, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=2.0)
    except (OSError, subprocess.SubprocessError):
        return {}, []
    return parse_nvidia(text.decode("ascii", "replace"))


def parse_nvidia(text: str) -> "tuple[dict[str, Any], list[float]]":
    """Parse a line for each card: percent, MiB in use, MiB, watts; a card may lack any of them."""
    cards = [[_parse_number(cell) for cell in line.split(",")] for line in text.split("\n") if "," in line]
    cards = [card for card in cards if len(card) == 4]
    loads = [card[0] for card in cards if card[0] is not None]
    if not loads:
        return {}, []
    found = {"gpu": {"gpus": float(len(loads)), "used_gpus": round(sum(loads) / 100.0, 4)}}
    used = sum(card[1] or 0.0 for card in cards)
    total = sum(card[2] or 0.0 for card in cards)
    if total:
        found["gpu_memory"] = {"gpu_total_bytes": total * 2**20, "gpu_used_bytes": used * 2**20}
    return found, [card[3] for card in cards if card[3] is not None]


def _parse_number(cell: str) -> "float | None":
    try:
        value = float(cell)
    except ValueError:  # [N/A], [Not Supported]
        return None
    return value if 0.0 <= value < 1e9 else None


def read_power(root: str, parts: "list[float]") -> "float | None":
    """Read the watts that the host draws; ``parts``: those of processors and cards. None where unknown."""
    rails = _read_jetson_rails(root) + _read_hwmon_rails(root)
    whole = [watts for name, watts in rails if name.upper().endswith("_IN")]
    if whole:
        return sum(whole)
    discharge = _read_discharge(root)
    if discharge is not None:
        return discharge
    parts = parts + [watts for _, watts in rails]
    return sum(parts) if parts else None


def _read_jetson_rails(root: str) -> "list[tuple[str, float]]":
    """Read (name, watts) of the rails of a Jetson under JetPack 4."""
    rails = []
    for chip in system_files.list_folder(root + _INA_FOLDER, "-"):
        for folder in system_files.list_folder(chip, "iio:device"):
            for number in range(3):
                name = system_files.read_text("%s/rail_name_%d" % (folder, number))
                milliwatts = _read_number("%s/in_power%d_input" % (folder, number))
                if name and milliwatts is not None:
                    rails.append((name, milliwatts / 1000.0))
    return rails


def _read_hwmon_rails(root: str) -> "list[tuple[str, float]]":
    """Read (name, watts) of the sensors of hwmon: of power, or of voltage and current of one channel."""
    rails = []
    for chip in system_files.list_folder(root + "/sys/class/hwmon"):
        files = {os.path.basename(path) for path in system_files.list_folder(chip)}
        for name in sorted(files):
            if name in ("power1_input", "power1_average"):
                microwatts = _read_number("%s/%s" % (chip, name))
                rails += [] if microwatts is None else [("", microwatts / 1e6)]
            if not (name.startswith("curr") and name.endswith("_input")):
                continue
            number = name[len("curr") : -len("_input")]
            label = system_files.read_text("%s/in%s_label" % (chip, number))
            volts = _read_number("%s/in%s_input" % (chip, number))
            amperes = _read_number("%s/%s" % (chip, name))
            if label and volts is not None and amperes is not None:
                rails.append((label, volts * amperes / 1e6))
    return rails


def _read_package_energies(root: str) -> "dict[str, tuple[float, float]]":
    """Read (microjoules, where the counter begins anew) by processor package; only root may, as a rule."""
    found = {}
    for zone in system_files.list_folder(root + "/sys/class/powercap", ":"):
        # intel-rapl:0 is a package, intel-rapl:0:1 a part of it; AMD's have the same names.
        if os.path.basename(zone).count(":") != 1 or "mmio" in zone:
            continue
        energy = _read_number(zone + "/energy_uj")
        if energy is not None and system_files.read_text(zone + "/name") != "psys":
            found[zone] = energy, _read_number(zone + "/max_energy_range_uj") or 0.0
    return found


def _compute_watts(
    before: "dict[str, tuple[float, float]]", now: "dict[str, tuple[float, float]]", seconds: float
) -> "list[float]":
    """Compute the watts of each package between two readings, one of which may have begun anew."""
    if seconds < _MIN_SECONDS:
        return []
    found = []
    for zone in sorted(before.keys() & now.keys()):
        joules = (now[zone][0] - before[zone][0]) / 1e6
        found.append(max(0.0, joules if joules >= 0 else joules + now[zone][1] / 1e6) / seconds)
    return found


def _list_batteries(root: str) -> "list[str]":
    """List the batteries of the host, without those of a mouse or a pen."""
    return [
        supply
        for supply in system_files.list_folder(root + "/sys/class/power_supply")
        if system_files.read_text(supply + "/type") == "Battery"
        and system_files.read_text(supply + "/scope") != "Device"
    ]


def read_used_charge(root: str = "") -> "float | None":
    """Read what is gone of the batteries as a share of all, 0..1; None without a battery."""
    shares = [_read_number(supply + "/capacity") for supply in _list_batteries(root)]
    known = [min(100.0, share) for share in shares if share is not None]
    return 1.0 - sum(known) / len(known) / 100.0 if known else None


def _read_discharge(root: str) -> "float | None":
    """Read the watts that batteries give; None where none does."""
    found = []
    for supply in _list_batteries(root):
        if system_files.read_text(supply + "/status") != "Discharging":
            continue
        microwatts = _read_number(supply + "/power_now")
        if microwatts is None:
            volts, amperes = _read_number(supply + "/voltage_now"), _read_number(supply + "/current_now")
            microwatts = None if volts is None or amperes is None else volts * amperes / 1e6
        found += [] if microwatts is None else [microwatts / 1e6]
    return sum(found) if found else None


def _read_number(path: str) -> "float | None":
    """Read a number, without its sign: some batteries state what they give as negative."""
    text = system_files.read_text(path).lstrip("-")
    return float(text) if text.isdigit() else None
