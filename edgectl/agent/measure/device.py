# SPDX-License-Identifier: Apache-2.0
"""Device profiler: CPU and memory, capacity and usage, and load and temperature where the host shows them.

Reads /proc and /sys, which is what psutil reads, and imports psutil only where they leave something open: its
import costs more CPU than the rest of a probe. The document is the same.
"""

import os
import sys
import time

from ..link.boot import is_dir
from . import cgroup, system_files

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from .hardware import HardwareMeter

# Idle columns of /proc/stat: idle and iowait. guest and guest_nice (the last two) are included in user and
# nice.
_IDLE_COLUMNS = (3, 4)
_BUSY_COLUMNS = 8
# Jetson: /sys/devices/gpu.0/load (JetPack 4), platform/17000000.gpu/load (5),
# platform/bus@0/17000000.gpu/load (6).
_GPU_FOLDERS = ("/sys/devices", "/sys/devices/platform", "/sys/devices/platform/bus@0")
_HARDWARE_FOLDERS = ("/sys/class/hwmon", "/sys/class/powercap", "/sys/class/power_supply")


def find_psutil_folder() -> "str | None":
    """Find the folder that holds psutil, without importing it; None where the host does not have it.

    Python was started without ``site``, so the usual folders are searched here.
    """
    lib = "lib/python%d.%d/" % sys.version_info[:2]
    # Two levels above the program.
    prefixes = [sys.executable.rsplit("/", 2)[0], sys.prefix]
    folders = ["%s/%ssite-packages" % (prefix, lib) for prefix in prefixes]
    if sys.prefix == "/usr":
        folders += ["/usr/local/" + lib + "dist-packages", "/usr/lib/python3/dist-packages"]
    return next((folder for folder in folders if is_dir(folder + "/psutil")), None)


def import_psutil() -> "ModuleType | None":
    """Import psutil where the host has it."""
    folder = find_psutil_folder()
    if folder is not None and folder not in sys.path:
        sys.path.append(folder)
    try:
        import psutil
    except ImportError:
        return None
    return psutil


def list_usable_cpus() -> "set[int]":
    """List the CPUs on which this process may run."""
    return os.sched_getaffinity(0)


def _read_busy_s(allowed: "set[int]") -> float:
    """Read the seconds since boot in which the allowed CPUs were busy."""
    total = 0.0
    # What follows the CPUs is longer.
    for line in (
        system_files.read_file("/proc/stat").partition(b"\nintr")[0].decode("ascii", "replace").splitlines()
    ):
        name, _, rest = line.partition(" ")
        if name[:3] == "cpu" and name[3:].isdigit() and int(name[3:]) in allowed:
            columns = [int(column) for column in rest.split()[:_BUSY_COLUMNS]]
            total += sum(columns) - sum(columns[index] for index in _IDLE_COLUMNS)
    return total / system_files.TICKS_PER_S


def _read_own_cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _read_limited_s(limit: cgroup.CgroupLimit) -> float:
    # Only for hosts with a limit: this and its like below are a third of the code of control groups.
    from .cgroup_usage import read_cpu_used_s

    return read_cpu_used_s(limit)


class CpuMeter:
    """Meter of the CPU in use since its creation or its last measurement, without that of the agent and its
    checks.
    """

    def __init__(self) -> None:
        self.allowed = list_usable_cpus()
        self.limit = cgroup.find_cpu_limit()
        if self.limit is not None and (
            self.limit.value >= len(self.allowed) or _read_limited_s(self.limit) < 0
        ):
            self.limit = None
        self.start = self._read_now()

    def _read_now(self) -> "tuple[float, float, float]":
        return (time.monotonic(), self._used_s(), _read_own_cpu_s())

    def _used_s(self) -> float:
        return _read_busy_s(self.allowed) if self.limit is None else _read_limited_s(self.limit)

    def measure(self) -> "dict[str, float]":
        """Measure ``cores`` (the smaller of affinity and quota) and ``used_cores``, 0..cores."""
        (since, used_s, own_s), self.start = self.start, self._read_now()
        seconds = max(1e-3, self.start[0] - since)
        used = (self.start[1] - used_s) - (self.start[2] - own_s)
        cores = float(len(self.allowed)) if self.limit is None else self.limit.value
        return {"cores": round(cores, 4), "used_cores": round(min(cores, max(0.0, used / seconds)), 4)}


def read_memory() -> "dict[str, int]":
    """Read the bytes that this host has (the smaller of the machine's and the control group's limit) and
    uses.
    """
    total, used = read_machine_memory()
    limit = cgroup.find_memory_limit()
    if limit is not None and limit.value < total:
        from .cgroup_usage import read_memory_used

        return {
            "total_bytes": int(limit.value),
            "used_bytes": min(int(limit.value), read_memory_used(limit)),
        }
    return {"total_bytes": total, "used_bytes": used}


def read_machine_memory(path: str = "/proc/meminfo") -> "tuple[int, int]":
    """Read (total, used) bytes of the machine."""
    text = b"\n" + system_files.read_file(path)
    total, free = _find_bytes(text, b"MemTotal"), _find_bytes(text, b"MemAvailable")
    # Linux before 3.14 states no available memory, and psutil estimates it.
    psutil = import_psutil() if free is None else None
    if psutil is not None:
        seen = psutil.virtual_memory()
        return seen.total, seen.total - seen.available
    if total is None:
        raise OSError("%s does not state the memory" % path)
    if free is None:
        free = sum(_find_bytes(text, name) or 0 for name in (b"MemFree", b"Cached", b"Buffers"))
    return total, total - free


def _find_bytes(text: bytes, name: bytes) -> "int | None":
    """Find the line ``name: number kB``, without a look at the other 50; None where there is none."""
    rest = text.partition(b"\n" + name + b":")[2]
    return int(rest.split(None, 1)[0]) * 1024 if rest else None


def read_load_1m() -> float:
    """Read the one-minute load average."""
    return float(system_files.read_file("/proc/loadavg").split()[0])


def read_temperature_c(root: str = "") -> "float | None":
    """Read the hottest plausible sensor in degrees Celsius; None where the host shows none."""
    texts = [(path, system_files.read_text(path)) for path in _list_sensor_files(root)]
    found = [
        int(text) / 1000.0
        for path, text in texts
        if text.lstrip("-").isdigit() and not (text == "100000" and _is_constant(path))
    ]
    # psutil knows more places of sensors; without a chip there is none.
    psutil = (
        import_psutil() if not found and not root and system_files.list_folder("/sys/class/hwmon") else None
    )
    if psutil is not None:
        found = _read_psutil_temperatures(psutil)
    plausible = [value for value in found if 0.0 < value < 150.0]
    return max(plausible) if plausible else None


def _is_constant(path: str) -> bool:
    """Whether a sensor is the one of Jetsons that states 100 degrees, whatever it is."""
    return system_files.read_text(os.path.dirname(path) + "/type") == "PMIC-Die"


def _list_sensor_files(root: str) -> "list[str]":
    zones = [
        "%s/temp" % zone for zone in system_files.list_folder(root + "/sys/class/thermal", "thermal_zone")
    ]
    chips = [
        file
        for chip in system_files.list_folder(root + "/sys/class/hwmon")
        for file in system_files.list_folder(chip, "temp")
    ]
    return zones + [
        file for file in chips if os.path.basename(file).startswith("temp") and file.endswith("_input")
    ]


def _read_psutil_temperatures(psutil: "ModuleType") -> "list[float]":
    try:
        return [sensor.current for sensors in psutil.sensors_temperatures().values() for sensor in sensors]
    except (OSError, AttributeError, ValueError):
        return []


def start_hardware_meter(root: str = "") -> "HardwareMeter | None":
    """Start the meter of GPU, power and battery; None where no folder shows any of them."""
    gpus = [path for folder in _GPU_FOLDERS for path in system_files.list_folder(root + folder, "gpu")]
    has_tool = _has_nvidia_smi()
    if not (gpus or has_tool or any(system_files.list_folder(root + folder) for folder in _HARDWARE_FOLDERS)):
        return None
    from .hardware import HardwareMeter

    return HardwareMeter(root, gpus, read_machine_memory, has_tool)


def measure_hardware(meter: "HardwareMeter | None") -> "dict[str, Any]":
    """Measure GPU, power and battery as far as they are there: parts of the reply to a probe."""
    return {"gpu_share": None} if meter is None else meter.measure()


def _has_nvidia_smi() -> bool:
    """Whether the tool of NVIDIA's driver is installed."""
    folders = os.environ.get("PATH", os.defpath).split(os.pathsep)
    return any(os.access(folder + "/nvidia-smi", os.X_OK) for folder in folders if folder)
