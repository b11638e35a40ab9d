"""The device profiler: cores and bytes this host has and uses, and what else it shows (load, temperature, GPU).

psutil where the host has it, /proc and /sys where it does not; the document is the same.
"""

import os
import sys
import time

from . import cgroup, proc

# Idle columns of /proc/stat: idle and iowait. guest and guest_nice (the last two) are already in user and nice.
_IDLE = (3, 4)
_BUSY_COLUMNS = 8
# Jetson: /sys/devices/gpu.0/load (JetPack 4), platform/17000000.gpu/load (5), platform/bus@0/17000000.gpu/load (6).
_GPU_FOLDERS = ("/sys/devices", "/sys/devices/platform", "/sys/devices/platform/bus@0")


def find_psutil():
    """psutil, or None. Python was started without ``site``, so the usual folders are looked through here."""
    lib = "lib/python%d.%d/" % sys.version_info[:2]
    prefixes = [os.path.dirname(os.path.dirname(sys.executable)), sys.prefix]
    folders = [os.path.join(prefix, lib, "site-packages") for prefix in prefixes]
    if sys.prefix == "/usr":
        folders += ["/usr/local/" + lib + "dist-packages", "/usr/lib/python3/dist-packages"]
    sys.path += [folder for folder in folders if os.path.isdir(os.path.join(folder, "psutil"))][:1]
    try:
        import psutil
    except ImportError:
        return None
    return psutil


def cpu_list() -> set:
    """The CPUs on which this process may run."""
    return os.sched_getaffinity(0)


def _busy_s(allowed: set) -> float:
    """Seconds that the allowed CPUs have been busy since boot."""
    total = 0.0
    for line in proc.read("/proc/stat").decode("ascii", "replace").splitlines():
        name, _, rest = line.partition(" ")
        if name[:3] == "cpu" and name[3:].isdigit() and int(name[3:]) in allowed:
            columns = [int(column) for column in rest.split()[:_BUSY_COLUMNS]]
            total += sum(columns) - sum(columns[index] for index in _IDLE)
    return total / proc.TICKS


def _own_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class CpuMeter:
    """CPU in use between its making, or the reading before, and ``reading``, without what the agent itself and its checks used."""

    def __init__(self) -> None:
        self.allowed = cpu_list()
        self.limit = cgroup.cpu_limit()
        if self.limit is not None and (
            self.limit.value >= len(self.allowed) or cgroup.cpu_used_s(self.limit) < 0
        ):
            self.limit = None
        self.start = self._now()

    def _now(self) -> tuple:
        return (time.monotonic(), self._used_s(), _own_s())

    def _used_s(self) -> float:
        return _busy_s(self.allowed) if self.limit is None else cgroup.cpu_used_s(self.limit)

    def reading(self) -> dict:
        """``cores`` (the smaller of affinity and quota) and ``used_cores``, 0..cores."""
        (since, used_s, own_s), self.start = self.start, self._now()
        seconds = max(1e-3, self.start[0] - since)
        used = (self.start[1] - used_s) - (self.start[2] - own_s)
        cores = float(len(self.allowed)) if self.limit is None else self.limit.value
        return {"cores": round(cores, 4), "used_cores": round(min(cores, max(0.0, used / seconds)), 4)}


def memory(psutil) -> dict:
    """Bytes this host has (the smaller of the machine's and the control group's limit) and uses."""
    total, used = _machine_memory(psutil)
    limit = cgroup.memory_limit()
    if limit is not None and limit.value < total:
        return {"total_bytes": limit.value, "used_bytes": min(limit.value, cgroup.memory_used(limit))}
    return {"total_bytes": total, "used_bytes": used}


def _machine_memory(psutil) -> tuple:
    if psutil is not None:
        seen = psutil.virtual_memory()
        return seen.total, seen.total - seen.available
    lines = (line.split() for line in proc.read("/proc/meminfo").decode("ascii", "replace").splitlines())
    kib = {words[0].rstrip(":"): int(words[1]) for words in lines if len(words) > 1 and words[1].isdigit()}
    free = kib.get("MemAvailable", kib.get("MemFree", 0) + kib.get("Cached", 0) + kib.get("Buffers", 0))
    return kib["MemTotal"] * 1024, (kib["MemTotal"] - free) * 1024


def load_1m() -> float:
    """The one-minute load average."""
    return float(proc.read("/proc/loadavg").split()[0])


def temperature_c(psutil):
    """The hottest plausible sensor in degrees Celsius; None where the host shows none."""
    found = _psutil_temperatures(psutil) if psutil is not None else []
    if not found:
        texts = [_plain(path) for path in _sensor_files()]
        found = [int(text) / 1000.0 for text in texts if text.lstrip("-").isdigit()]
    plausible = [value for value in found if 0.0 < value < 150.0]
    return max(plausible) if plausible else None


def _sensor_files() -> list:
    zones = ["%s/temp" % zone for zone in _inside("/sys/class/thermal") if "thermal_zone" in zone]
    chips = [file for chip in _inside("/sys/class/hwmon") for file in _inside(chip)]
    return zones + [
        file for file in chips if os.path.basename(file).startswith("temp") and file.endswith("_input")
    ]


def _inside(folder: str) -> list:
    try:
        return sorted(os.path.join(folder, name) for name in os.listdir(folder))
    except OSError:
        return []


def _psutil_temperatures(psutil) -> list:
    try:
        return [sensor.current for sensors in psutil.sensors_temperatures().values() for sensor in sensors]
    except (OSError, AttributeError, ValueError):
        return []


def _plain(path: str) -> str:
    return proc.read(path).decode("ascii", "replace").strip()


def gpu_share():
    """How busy the GPU is, 0..1: Jetson's load file, else nvidia-smi where it is installed; None without either."""
    for path in [
        path for folder in _GPU_FOLDERS for path in _inside(folder) if "gpu" in os.path.basename(path)
    ]:
        text = _plain(path + "/load")
        if text.isdigit():
            return min(1.0, int(text) / 1000.0)
    return _nvidia_smi()


def _nvidia_smi():
    folders = os.environ.get("PATH", os.defpath).split(os.pathsep)
    if not any(os.access(os.path.join(folder, "nvidia-smi"), os.X_OK) for folder in folders):
        return None
    import subprocess

    argv = ["nvidia-smi", "--query-gpu=utilization.gpu", "--format=csv,noheader,nounits"]
    try:
        text = subprocess.check_output(argv, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=2.0)
        shares = [float(line) / 100.0 for line in text.decode("ascii", "replace").split("\n") if line.strip()]
    except (OSError, ValueError, subprocess.SubprocessError):
        return None
    return min(1.0, sum(shares) / len(shares)) if shares else None
