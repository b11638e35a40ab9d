"""What a probe says where a profiler lives: its smoothed rates, and everything else as it is now. No sample window has to pass."""

from . import device, followed, network, proc, seat, state, status, task

# A sample counts as fresh for so many periods.
FRESH = 3.0
ALIVE = ("starting", "running", "ready")


def latest(request: dict):
    """The measured part of a reply, or None where no profiler lives that measures what is asked, or its last sample is old."""
    sitter = seat.sitter(request["host"])
    if sitter is None:
        return None
    description, _, sample = sitter.read()
    if not sample or description.get("wishes") != seat.wishes(request):
        return None
    age = proc.uptime() - sample["at"]
    return _parts(request, sample, age) if 0.0 <= age < FRESH * sample["period_s"] else None


def _parts(request: dict, sample: dict, age: float) -> dict:
    rates, levels = sample["rates"], sample["levels"]
    now = _tasks(request, sample)
    alive = [rate for entry, rate in now.values() if entry["state"] in ALIVE]
    used = max(0.0, rates["cpu"]) + sum(max(0.0, rate["used_cores"]) for rate in alive)
    return {
        "resident": True,
        "sample_age_s": round(age, 3),
        "psutil": False,
        "window_s": 0.0,
        "cpu": {"cores": levels["cores"], "used_cores": round(min(levels["cores"], used), 4)},
        "memory": device.memory(None),
        "temperature_c": levels["temperature_c"],
        "gpu_share": levels["gpu_share"],
        "interfaces": {
            name: network.interface(rate, levels["speeds"].get(name))
            for name, rate in rates["interfaces"].items()
        },
        "links": {robot: _link(robot, rate, levels, alive) for robot, rate in rates["links"].items()},
        "tasks": {name: dict(entry, **_shown(rate)) for name, (entry, rate) in now.items()},
    }


def _link(robot: str, rate: dict, levels: dict, alive: list) -> dict:
    """What no task moves, and what the tasks move that live now."""
    own = [each["robots"][robot] for each in alive if robot in each["robots"]]
    return {
        "rx_bytes_per_s": round(max(0.0, rate["rx"]) + sum(each["rx"] for each in own), 1),
        "tx_bytes_per_s": round(max(0.0, rate["tx"]) + sum(each["tx"] for each in own), 1),
        "rtt_ms": None if rate["rtt_ms"] is None else round(rate["rtt_ms"], 3),
        "interface": levels["ways"][robot],
        "reachable": levels["reachable"][robot],
    }


def _shown(rate: dict) -> dict:
    return dict(
        task.shown(rate),
        used_cores=round(max(0.0, rate["used_cores"]), 4),
        used_bytes=int(rate["used_bytes"]),
    )


def _tasks(request: dict, sample: dict) -> dict:
    """Task -> (entry as it is now, its rates). The process table is read only for what ``detect`` may find and for what is new."""
    host, detect = request["host"], request.get("detect", [])
    entries = status.entries(host, None)
    if detect or any(
        entry["state"] in ALIVE and followed.key(name, entry) not in sample["rates"]["tasks"]
        for name, entry in entries.items()
    ):
        return _looked_up(host, detect, sample)
    return {
        name: (entry, _sampled(name, entry, sample) or _nothing()) for name, entry in sorted(entries.items())
    }


def _looked_up(host: str, detect: list, sample: dict) -> dict:
    table = proc.processes()
    groups = task.groups(host, state.task_names(host), detect, table)
    flows = None
    found = {}
    for name, group in sorted(groups.items()):
        rate = _sampled(name, group.entry, sample)
        if rate is None and group.pids:
            flows = network.since_opened(sample["addresses"]) if flows is None else flows
            rate = _since_start(group, table, flows, sample["addresses"])
        found[name] = (group.entry, rate or _nothing())
    return found


def _sampled(name: str, entry: dict, sample: dict):
    """The smoothed rates of this very run; None where it is too young to have any. What has ended uses nothing."""
    known = followed.key(name, entry)
    rate = sample["rates"]["tasks"].get(known)
    if rate is None or entry["state"] not in ALIVE:
        return None
    return dict(rate, used_bytes=sample["levels"]["bytes"].get(known, 0))


def _since_start(group, table: dict, flows: list, addresses: dict) -> dict:
    """Of a task that was started after the last sample: its average since then."""
    seconds = max(0.1, group.entry["age_s"])
    rate = task.traffic(task.holdings(group.pids), flows, addresses, seconds)
    return dict(rate, used_cores=task.cores(group, table, {}, seconds), used_bytes=task.memory(group, table))


def _nothing() -> dict:
    return {"rx": 0.0, "tx": 0.0, "robots": {}, "used_cores": 0.0, "used_bytes": 0}
