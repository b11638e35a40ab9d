# SPDX-License-Identifier: Apache-2.0
"""Glossary of the outputs: type, unit and meaning of each key, heading of each column.

One quantity has one key, one unit and one type everywhere. docs/reference/outputs.md is generated
from here.
"""

from collections.abc import Mapping
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.resource import AFFINITY, CPU, RESOURCES, SPARE_TERMS, TERMS, Resource
from edgectl.views.text import Cell, Row


class KeyType(StrEnum):
    """The JSON type of a key; any of them may be null.

    An ``object`` has keys of the glossary; the keys of a ``map`` are names, and its values may be objects.
    An ``opaque`` value is passed on as it is.
    """

    TEXT = "text"
    NUMBER = "number"
    FLAG = "flag"
    INSTANT = "instant"
    OBJECT = "object"
    LIST = "list"
    MAP = "map"
    OPAQUE = "opaque"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyEntry:
    """One key. ``unit`` of a number; empty: a count, a ratio or a share."""

    key: str
    type: KeyType
    meaning: str
    unit: str = ""


_UNITS = {
    "_bytes_per_s": "bytes/s", "_per_s": "1/s", "_dbm": "dBm",
    "_bytes": "bytes", "_cores": "cores", "_ms": "ms", "_s": "s", "_c": "°C", "_w": "W",
}  # fmt: skip


def list_keys() -> tuple[KeyEntry, ...]:
    """Every key, in alphabetical order."""
    entries = [
        KeyEntry(key=key, type=kind, meaning=meaning, unit=_find_unit(key) if kind is KeyType.NUMBER else "")
        for kind, meanings in _MEANINGS.items()
        for key, meaning in meanings.items()
    ]
    return tuple(sorted(entries, key=lambda entry: entry.key))


def _find_unit(key: str) -> str:
    units = {f"_{resource.unit.name}": resource.unit.name for resource in RESOURCES} | _UNITS
    return next((unit for suffix, unit in units.items() if key.endswith(suffix)), "")


# An amount of a resource is keyed by what it is and its unit, inside the object of the resource.
_AMOUNTS = {
    "used": "usage of {}",
    "demand": "demand of a task on its host for {}",
    "excess": "usage of {} minus demand",
    "capacity": "capacity of a host or a link for {}",
}


def _describe_amounts() -> dict[str, str]:
    return {
        f"{amount}_{resource.unit.name}": text.format(resource.name)
        for resource in reversed(RESOURCES)  # memory names bytes, not the memory of a GPU
        for amount, text in _AMOUNTS.items()
        if not (resource.per_link and amount == "capacity") and not (resource.optional and amount == "excess")
    }


def get_flat_used_key(resource: Resource) -> str:
    """The key of the usage of ``resource`` where there is no object of the resource; cores are the CPU's."""
    key = f"used_{resource.unit.name}"
    return key if resource is CPU else f"{resource.name}_{key}"


def _list_amount_headings() -> dict[str, str]:
    """``CPU``, ``CPU DEMAND``, ``CPU EXCESS`` and ``CPU%``, and the term of the utility."""
    headings: dict[str, str] = {}
    for resource in RESOURCES:
        title, unit = resource.title, resource.unit.name
        headings |= {
            f"{resource.name}.used_{unit}": title,
            f"{resource.name}.demand_{unit}": f"{title} DEMAND",
            f"{resource.name}.excess_{unit}": f"{title} EXCESS",
            f"{resource.name}.share": f"{title}%",
        }
        if not resource.per_link:
            headings |= {f"{resource.name}.capacity_{unit}": title, f"{resource.name}.usage": unit.upper()}
    terms = {term: "AFFINITY" if term == AFFINITY else term.upper() for term in TERMS}
    return headings | {f"utility.{term}": title for term, title in terms.items()}


_MEANINGS: dict[KeyType, dict[str, str]] = {
    KeyType.TEXT: {
        "access_point": "address of the access point that a radio has joined",
        "action": "action: start, stop, move, restart, adopt, keep, hold, complete, defer, unplaced, none",
        "address": "address of a host in the inventory",
        "default": "value that counts if a key of a file is omitted",
        "meaning": "meaning of a key of a file, a code or a check",
        "name": "path of a key of a file, a code, or a check",
        "allowed": "values that a key of a file may have",
        "attention": "reason why an operator should look at a task; null: none",
        "awaited": "state that is waited for: ready, completed or gone",
        "boot_id": "identity of the boot of a host",
        "capacity_source": "source of the capacity of a link: declared, measured, nic or assumed; "
        "live: tcp, probe or radio",
        "change": "change that would alter a decision",
        "check": "name of a check of doctor",
        "class": "class of hosts with equal cores and memory",
        "command": "command line",
        "connection": "transport of a host: ssh, openssh or local",
        "context": "name of a context: a fleet that a settings file names",
        "counters": "byte counters of a host: installed, or why they cannot be read",
        "detail": "detail of a state or a phase",
        "digest": "digest of the specification of an experiment, or of a world of a sweep",
        "fastest": "scheme that is the fastest in a world of a sweep",
        "edge": "name of an edge",
        "edgectl": "version of edgectl",
        "image": "image of a container; null: a command of the host",
        "enforcement": "enforcement of the limits of a task",
        "error": "cause of a failure",
        "experiment": "name of an experiment",
        "fingerprint": "SHA256 fingerprint of a host key",
        "fleet": "name of a fleet; empty: none, or none is recorded",
        "hint": "remedy",
        "hold": "command that holds a robot during a handoff",
        "host": "name of a host; null: none",
        "instance": "identity of one start of a task",
        "inventory_digest": "digest of the inventory",
        "key_type": "type of a host key",
        "kind": "kind of an item, or of an event",
        "level": "severity of a finding: ok, warning or failed",
        "load": "command that takes the state of a task",
        "located": "host of a task after an action",
        "lock": "holder of the lock that a cycle waits for",
        "mark": "mark of the operator: cordoned, draining or fenced",
        "message": "text of an event, a finding or a mark",
        "on_unreachable": "policy for an unreachable host: hold or replace",
        "origin": "where a setting comes from: an option, a variable, or FILE:LINE",
        "order": "order of a handoff: stop-first or start-first",
        "outcome": "outcome of an action or a revision",
        "partial": "traffic missing in the reading of a link or task: udp unseen, udp counted by link only",
        "phase": "phase of an action",
        "policy": "name of a policy",
        "previous_host": "host before the decision",
        "proxy_jump": "jump host of a connection",
        "python": "version of Python",
        "reason": "reason of a decision",
        "reference": "label of the reference values of a simulation",
        "release": "command that releases a robot after a handoff",
        "restart": "restart policy of a task",
        "robot": "name of a robot",
        "role": "edge or robot",
        "runner_up": "host with the second highest utility",
        "runtime": "runtime of the supervisors on a host: auto, systemd or process",
        "safe_when": "command that succeeds when a handoff is safe",
        "save": "command that prints the state of a task",
        "scenario": "name of a scenario",
        "answer": "result of the comparison of the main scheme with its base, in a sentence",
        "base": "name of the scheme that another is compared with",
        "metric": "name of a metric that schemes are compared in",
        "event_name": "name of an event of a mission",
        "scheme": "name of a scheme",
        "subject": "host, link, task or program of an event of a mission",
        "setting": "name of a setting",
        "sha256": "SHA-256 of a state that a move transferred",
        "spec_hash": "digest of the specification that was started",
        "started_by": "user and machine whose edgectl started a task",
        "state": "state of a task, a profiler or a host key",
        "status": "status of a host: ok, unreachable or not probed",
        "task": "name of a task",
        "task_kind": "service or job",
        "tasks_digest": "digest of the task files",
        "template": "entry of the task files that a task was made from",
        "term": "term of the utility",
        "topic": "latched topic whose last message is the state of a task",
        "type": "type of a change: ADDED, MODIFIED or DELETED",
        "unit": "unit of an amount",
        "until": "state that a need waits for",
        "used_source": "source of the traffic of a link: tcp (connections), or counters (all protocols)",
        "user": "user",
        "verb": "command that made a revision or set a mark",
        "pinned_to": "host that the task file or edgectl move pins a task to",
        "tie_rule": "rule that decides between hosts of equal utility",
        "winner": "host that would win after a change",
    },
    KeyType.NUMBER: {
        **_describe_amounts(),
        **{get_flat_used_key(each): f"{each.name} usage" for each in RESOURCES if each is not CPU},
        "capacity_bytes_per_s": "capacity of a link",
        "adds": "contribution of a term to the lead",
        "capacity_age_s": "age of the reading of a live capacity",
        "age_s": "time since the start; of a task that has ended, since its end",
        "amount": "amount in the unit of its resource; a share where relative",
        "clock_skew_s": "clock of a host minus clock of the manager",
        "cycle": "number of a cycle",
        "cycles": "number of cycles",
        "deadline_s": "deadline of a task",
        "downtime_s": "gap of a handoff, from stop to ready",
        "gap_s": "longest silence of a task at its robot during a handoff, where the task states heard",
        "duration_s": "time that an operation took",
        "every_s": "requested period",
        "exit_code": "exit code of a task that ended",
        "format_version": "version of the document",
        "generation": "number of a start; the highest is the current one",
        "gpu_share": "usage of the GPU as a share",
        "mission_s": "mean time of a simulated mission",
        "half_ci95": "half width of the 95 % confidence interval",
        "handoffs": "number of handoffs",
        "here": "utility of a term on the chosen host",
        "id": "number of an event",
        "last_exit": "exit code before the last restart",
        "lead": "utility above that of the next host",
        "host_load": "share of the CPU of a host that others than the task use",
        "low_ms": "bound of a predicted latency, below which few jobs are expected",
        "high_ms": "bound of a predicted latency, above which few jobs are expected",
        "p50_ms": "median of a latency, measured over the last minutes or predicted",
        "p95_ms": "95th percentile of a latency",
        "p99_ms": "99th percentile of a latency",
        "service_ms": "time of a job on an idle host, median",
        "transfer_ms": "time of the bytes of a job on the free part of the link",
        "waiting_ms": "mean time that the load of others adds to a job",
        "load_1m": "load average over one minute",
        "load_s": "time until a state was loaded",
        "max": "maximum",
        "mean": "mean",
        "move_margin": "lead below which a task is not moved",
        "nominal_bytes_per_s": "declared, measured or assumed capacity of a link that carries less now",
        "next_in_s": "time until the next cycle",
        "noise": "variation of the utility from the measurements alone",
        "p50": "median",
        "p95": "95th percentile",
        "peak": "maximum of a share",
        "period_s": "period that is kept",
        "pid": "process id",
        "begin_s": "time from the start of a mission to an event, mean over the first ones of each run",
        "failures": "events of a mission that were not brought about, or not undone",
        "not_recovered": "events of a mission after which its tasks did not become as good as before",
        "occurrences": "events of a mission that happened, over all runs",
        "recovery_half_ci95_s": "half of the 95 % interval of the recovery",
        "recovery_s": "time after an event of a mission until its tasks were as good as before, mean of runs",
        "planned": "repetitions of each scheme",
        "port": "TCP port",
        "priority": "priority of a task",
        "restarts": "restarts of a task since its start",
        "revision": "number of a revision",
        "joined_s": "time since a radio joined its access point",
        "level_dbm": "level of the signal of a radio",
        "retries_per_s": "frames that a radio sent again",
        "rtt_ms": "round-trip time",
        "bound_ms": "deadline of a task: a latency above it is a miss",
        "count": "number of values",
        "max_ms": "highest latency of the last minutes",
        "misses": "latencies above the deadline since the start of the instance",
        "recent_count": "number of latencies of the last minutes",
        "recent_misses": "latencies above the deadline in the last minutes",
        "recent_s": "time over which the percentiles of a latency are",
        "run_count": "number of runs",
        "pair_count": "number of repetitions with a run of both schemes",
        "missing_pair_count": "number of repetitions with a run of one of two schemes only",
        "low": "lower end of a 95 % interval",
        "high": "upper end of a 95 % interval",
        "p": "probability of such a difference by chance",
        "p_holm": "the same, corrected for the number of comparisons",
        "effect": "mean of paired differences over their standard deviation (Hedges' g)",
        "bound": "share within which schemes count as equal",
        "equal_p": "probability that schemes seem equal within the bound by chance",
        "equal_p_holm": "the same, corrected for the number of comparisons of equality",
        "rx_bytes": "bytes received from a robot since the installation of the counters",
        "rx_bytes_per_s": "received traffic of an interface, or from a robot",
        "sample_age_s": "age of a sample",
        "samples": "number of samples",
        "save_s": "time until a state was saved",
        "sent_bytes": "bytes that the transfer of a state took",
        "size": "change as a share of the changed value",
        "size_bytes": "size of a state that a move transferred",
        "slack": "smallest change of the utility that would alter the decision",
        "span_s": "time between the first and the last sample",
        "speed_bytes_per_s": "speed of an interface",
        "ssim": "structural similarity of two maps, -1 to 1",
        "std": "standard deviation",
        "temperature_c": "highest temperature",
        "max_temperature_c": "temperature near which a host has fewer usable cores",
        "power_w": "power that a host draws, in watts",
        "there": "utility of a term on the runner-up",
        "total": "utility of the chosen host",
        "transfer_s": "time until a state was on the new host",
        "trials": "number of trials that are done",
        "ttl_left_s": "time until a profiler ends by itself",
        "ttl_s": "time without a call after which a profiler ends",
        "tcp_bytes": "the part of the bytes of a robot, in and out, that is TCP",
        "tx_bytes": "bytes sent to a robot since the installation of the counters",
        "tx_bytes_per_s": "sent traffic of an interface",
        "unfinished": "runs that ended at the limit",
        "unplaced": "tasks without a host",
        "unsettled": "cycles without a settled plan",
        "weight": "weight of a term",
    },
    KeyType.FLAG: {
        "hard_deadline": "whether a task goes only where it is expected to keep its deadline",
        "changed": "whether a mark was set or removed; false: it was so before",
        "chosen": "whether a context is in effect",
        "current": "whether a profiler has the settings of the files",
        "done": "whether every action was carried out",
        "dry_run": "whether nothing was changed, as --dry-run asks",
        "elsewhere": "whether the service time is that of another class of hosts",
        "enough": "whether there are enough samples for a demand",
        "fragile": "whether the lead is below the variation of the measurements",
        "given_up": "whether a task is not restarted any more",
        "in_files": "whether a task is in the task files",
        "interrupted": "whether the user interrupted the operation",
        "managed": "whether edgectl manages a task",
        "standby": "true of an inactive copy of a task",
        "ok": "whether a phase succeeded",
        "onboard": "whether a robot is a candidate for its own tasks",
        "paused": "whether a watch is paused",
        "reached": "whether a task has reached the awaited state",
        "relative": "whether an amount is a share of the capacity",
        "counted": "whether each address of a robot has a byte counter",
        "resident": "whether a resident profiler took the sample",
        "tasks_counted": "whether tasks in systemd scopes have byte counters",
        "until_measured": "whether a declaration counts only until there are measurements",
    },
    KeyType.INSTANT: {
        "at": "time of an event, a sample or a cycle",
        "contacted_at": "last contact with an unreachable host",
        "ended_at": "end of a task",
        "pinned_at": "time when edgectl move pinned a task",
        "pinned_until": "end of the pin of edgectl move; null: edgectl unpin",
        "placed_at": "time when a task came to its host",
        "started_at": "start of a task or a revision",
        "taken_at": "time of the probe",
    },
    KeyType.OBJECT: {
        "difference": "mean of paired differences, in the unit of the metric",
        "ratio": "geometric mean of paired ratios",
        **{resource.name: f"usage, demand and capacity of {resource.name}" for resource in RESOURCES},
        "carried": "state that a move transferred; absent: none",
        "decision": "decision of a plan made now",
        "moves_first": "move of another task that a change brings about before the one it is about",
        "declared": "declaration of a demand in a task file",
        "device": "sensors and interfaces of a host",
        "handoff": "handoff contract of a task",
        "item": "the thing of the document",
        "latency": "latency of a task, where it is measured",
        "object": "item that changed, as it is now",
        "pin": "pin that edgectl move has set on a task; null or absent: none",
        "placement": "host of a task as the manager remembers it",
        "spec": "specification of a task",
    },
    KeyType.LIST: {
        "comparisons": "comparisons of schemes by pairs of runs",
        "inventories": "inventory files that make one fleet together",
        "task_files": "task files, and directories of them",
        "values": "values of a setting",
        "actions": "actions with their phases",
        "assumed": "tasks whose demand counts as their usage",
        "assumptions": "assumptions of a scenario",
        "contributions": "contribution of each term to the lead",
        "cut_off_from": "robots that the host of a task cannot reach, while both answer edgectl",
        "edge_names": "names of edges",
        "events": "last events",
        "flips": "changes that would alter a decision, smallest first",
        "foreign_tasks": "living tasks of other fleets on the machine of a host",
        "history": "last samples, oldest first",
        "equal_hosts": "hosts with the same utility as the chosen one",
        "addresses": "addresses of a robot as a host resolves them",
        "host_names": "names of hosts",
        "items": "the things of the document",
        "keys": "paths of the keys below a key of a file",
        "left": "tasks that are left on drained hosts",
        "lines": "places of a task in a difference: - runs now, + would run",
        "log_tail": "last lines of output",
        "mission_events": "events of a mission",
        "needs": "tasks that have to run or to complete first",
        "node_names": "ROS nodes of a task, as its command and its question to the graph name them",
        "notes": "remarks on reference values",
        "other_tasks": "living tasks of this fleet on the machine of a host, filed under another host name",
        "passes": "passes of a drain",
        "pending": "changes of the plan that were not made",
        "phases": "phases of an action",
        "resting": "tasks that a watch leaves alone after a failure",
        "robot_names": "names of robots",
        "runs": "runs of a task by host",
        "standbys": "inactive copies of a task, present or planned",
        "schemes": "results by scheme",
        "task_names": "names of tasks",
        "warnings": "remarks on the whole",
    },
    KeyType.MAP: {
        "counts": "number of actions by name",
        "downtimes_s": "measured gaps in s by host, newest last",
        "env": "environment; secrets are masked",
        "figures": "estimates by metric",
        "hosts": "hosts by name",
        "interfaces": "network interfaces by name",
        "labels": "labels by key",
        "limits": "share of the capacity that may be planned with, by resource",
        "links": "links by robot",
        "robot_counters": "byte counters by robot",
        "maps": "SSIM by pair of maps",
        "metrics": "metrics that an application reports, by name",
        "off_by": "deviation from the reference as a share, by metric",
        "placements": "host by task",
        "latencies": "predicted latency of a task by host",
        "recoveries": "recovery after events of a mission, by kind",
        "reference_figures": "reference values by metric",
        "resources": "measured usage by resource",
        "settings": "settings of a world of a sweep, as its file writes them",
        "utilisation": "share of the capacity in use, by resource",
    },
    KeyType.OPAQUE: {
        "stdin": "request to the agent",
    },
}


# Headings of tables by column: the key of the document, with its object where that is needed.
HEADINGS = _list_amount_headings() | {
    "action": "ACTION",
    "address": "ADDRESS",
    "age_s": "AGE",
    "at": "AT",
    "boot": "BOOT",
    "bytes_per_s": "CAPACITY",
    "capacity_age_s": "AGE",
    "capacity_bytes_per_s": "CAPACITY",
    "capacity_source": "SOURCE",
    "check": "CHECK",
    "chosen": "NOW",
    "context": "CONTEXT",
    "class": "CLASS",
    "command": "COMMAND",
    "counters": "COUNTERS",
    "counts": "ACTIONS",
    "cpu.capacity_cores": "CORES",
    "declared": "DECLARED",
    "demand": "DEMAND",
    "device.gpu_share": "GPU",
    "device.load_1m": "LOAD",
    "device.temperature_c": "TEMPERATURE",
    "duration_s": "TOOK",
    "edge": "EDGE",
    "every_s": "EVERY",
    "excess": "EXCESS",
    "fleet": "FLEET",
    "fingerprint": "FINGERPRINT",
    "host": "HOST",
    "key_type": "TYPE",
    "host_names": "HOSTS",
    "interface": "INTERFACE",
    "inventories": "INVENTORY",
    "origin": "ORIGIN",
    "setting": "SETTING",
    "task_files": "TASKS",
    "values": "VALUE",
    "interfaces": "INTERFACES",
    "kind": "KIND",
    "labels": "LABELS",
    "lead": "LEAD",
    "links": "LINKS",
    "link": "LINK",
    "max": "MAX",
    "message": "MESSAGE",
    "metrics": "METRICS",
    "needs": "NEEDS",
    "node_names": "NODES",
    "next_host": "NEXT",
    "nominal_bytes_per_s": "NOMINAL",
    "now_host": "NOW",
    "onboard": "ONBOARD",
    "outcome": "OUTCOME",
    "p50": "P50",
    "p50_ms": "P50",
    "p95": "P95",
    "p95_ms": "P95",
    "p99_ms": "P99",
    "max_ms": "MAX",
    "bound_ms": "DEADLINE",
    "recent_misses": "RECENT MISSES",
    "misses": "MISSES",
    "count": "VALUES",
    "pid": "PID",
    "ready": "READY",
    "reason": "REASON",
    "resource": "RESOURCE",
    "restarts": "RESTARTS",
    "revision": "REVISION",
    "robot": "ROBOT",
    "robots": "ROBOTS",
    "role": "ROLE",
    "rtt_ms": "RTT",
    "rx_bytes": "BYTES IN",
    "rx_bytes_per_s": "RECEIVED",
    "sample_age_s": "SAMPLE AGE",
    "samples": "SAMPLES",
    "span_s": "SPAN",
    "speed_bytes_per_s": "SPEED",
    "started_at": "STARTED",
    "started_by": "STARTED BY",
    "state": "STATE",
    "status": "STATUS",
    "subject": "SUBJECT",
    "task": "TASK",
    "task_count": "TASKS",
    "term": "TERM",
    "throughput": "NETWORK",
    "total": "UTILITY",
    "ttl_left_s": "TTL LEFT",
    "tcp_bytes": "OF TCP",
    "tx_bytes": "BYTES OUT",
    "tx_bytes_per_s": "SENT",
    "used": "USED",
    "user": "USER",
    "verb": "VERB",
    "weight": "WEIGHT",
}


def head(*columns: str) -> Row:
    """The headings of ``columns``; an empty name is a column without one."""
    return tuple(Cell(HEADINGS[column] if column else "", _get_heading_style(column)) for column in columns)


def _get_heading_style(column: str) -> str:
    return "spare" if SPARE_TERMS & set(column.split(".")) else "head"


def head_of_resource(resource: Resource) -> Cell:
    """The heading of a column with the usage of ``resource``."""
    return Cell(resource.title, _get_heading_style(resource.name))


def list_shown_weights(weights: Mapping[str, float]) -> dict[str, float]:
    """The weights without those of budgets and of the latency that are not weighed."""
    return {name: weight for name, weight in weights.items() if weight or name not in SPARE_TERMS}
