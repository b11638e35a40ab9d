# SPDX-License-Identifier: Apache-2.0
"""Keys of each document that ``-o json`` prints, by its kind, and of the objects inside.

The glossary has the type, the unit and the meaning of each key.
"""

from collections.abc import Mapping

from edgectl.model.resource import HOST_RESOURCES, RESOURCES
from edgectl.views.glossary import get_flat_used_key

Keys = tuple[str, ...]
KeysByName = Mapping[str, Keys]

_RESOURCES = tuple(resource.name for resource in RESOURCES)
_LINK_SAMPLE = (
    "capacity_bytes_per_s", "used_bytes_per_s", "rtt_ms", "capacity_source", "capacity_age_s",
    "nominal_bytes_per_s", "used_source", "partial",
)  # fmt: skip
_HOST = (
    "host", "role", "address", "connection", "labels", "limits", "max_temperature_c", "onboard", "taken_at",
    "status", "error", "hint", "sample_age_s", "resident", "counters",
    *(resource.name for resource in HOST_RESOURCES), "links",
    "task_names", "other_tasks", "foreign_tasks", "device", "mark",
)  # fmt: skip
_ABSENT_TASK = ("task", "host", "taken_at", "state", "contacted_at", "managed", "pin")
_RUN = (
    "task", "host", "taken_at", "state", "detail", "age_s", "started_at", "ended_at", *_RESOURCES, "restarts",
    "pid", "instance", "generation", "managed", "given_up", "exit_code", "last_exit", "enforcement",
    "partial", "log_tail", "metrics", "latency", "pin",
)  # fmt: skip
_TASK = (*_RUN, "standby", "contacted_at", "in_files", "task_kind", "robot_names", "needs", "labels")
_LINK = ("edge", "robot", "taken_at", *_LINK_SAMPLE)
_EVENT = ("id", "at", "kind", "host", "task", "message")
_ACTION = (
    "task", "action", "outcome", "host", "previous_host", "located", "downtime_s", "gap_s", "carried",
    "phases", "error", "hint",
)  # fmt: skip
_RESULT = ("revision", "duration_s", "done", "interrupted", "actions", "standbys")
_REVISION = ("revision", "started_at", "user", "verb", "outcome", "duration_s", "counts")
_INTERVAL = ("mean", "low", "high")
_RECOVERY = ("occurrences", "not_recovered", "recovery_s", "recovery_half_ci95_s")
_ESTIMATE = ("mean", "std", "half_ci95", "run_count")

_OTHER_TASK = (
    "fleet", "host", "task", "state", "started_by", "age_s", "instance", "spec_hash", "generation",
)  # fmt: skip

_HOST_DETAILS = (*_HOST, "port", "user", "runtime", "proxy_jump", "env", "events", "contacted_at")
_TASK_DETAILS = (
    "task", "taken_at", "spec", "runs", "standbys", "placement", "pin", "downtimes_s", "decision", "events",
)  # fmt: skip

# Kind -> keys of each item of a list.
LIST_KEYS: KeysByName = {
    "change": ("type", "at", "object"),
    "details": ("kind", *dict.fromkeys((*_HOST_DETAILS, *_TASK_DETAILS))),
    "difference": ("task", "action", "reason", "previous_host", "host", "lines"),
    "graph-task": ("task", "host", "action", "total", "needs"),
    "context": ("context", "chosen", "inventories", "task_files", "origin"),
    "edge": _HOST,
    "all": ("kind", *dict.fromkeys((*_HOST, *_TASK, *_LINK))),
    "host": _HOST,
    "event": _EVENT,
    "hook": ("command", "outcome", "duration_s", "message"),
    "finding": ("host", "check", "level", "message", "hint"),
    "host-usage": (*_HOST, "history"),
    "host-key": ("host", "key_type", "fingerprint", "state", "error", "hint"),
    "link": _LINK,
    "mark": ("host", "task", "verb", "message", "changed", "dry_run", "pin", "decision"),
    "profile": ("task", "class", "host_names", "samples", "span_s", "enough", "resources"),
    "profiler": (
        "host", "state", "pid", "age_s", "every_s", "period_s", "samples", "sample_age_s", "cpu", "memory",
        "ttl_s", "ttl_left_s", "current", "detail", "error", "hint",
    ),
    "setting": ("setting", "values", "origin"),
    "replay": (
        "scheme", "policy", "move_margin", "cycles", "handoffs", "unplaced", "unsettled", "assumed",
        "utilisation",
    ),
    "world": ("settings", "digest", "run_count", "fastest", "schemes"),
    "awaited-task": ("task", "awaited", "reached", "state", "host"),
    "byte-counter": ("host", "counters", "tasks_counted", "robot_counters", "error", "hint"),
    "request": ("host", "phase", "task", "command", "stdin"),
    "revision": _REVISION,
    "robot": _HOST,
    "task": _TASK,
    "task-status": (*_RUN, "contacted_at", "node_names", "cut_off_from", "attention", "standby"),
    "task-usage": (*_RUN, "standby", "history"),
}  # fmt: skip

# Kind -> keys of a single item.
ITEM_KEYS: KeysByName = {
    "cycle": (
        "cycle", "at", "duration_s", "next_in_s", "paused", "hosts", "placements", "pending", "actions",
        "events", "resting", "warnings", "lock", "error",
    ),
    "drain": ("done", "left", "passes"),
    "edge": _HOST_DETAILS,
    "experiment": ("experiment", "digest", "planned", "trials", "answer", "comparisons", "schemes"),
    "explanation": (
        "task", "action", "reason", "host", "previous_host", "runner_up", "total", "lead", "slack", "noise",
        "fragile", "pinned_to", "equal_hosts", "tie_rule", "contributions", "flips",
        "deadline_s", "latencies", "standbys", "carried",
    ),
    "map-score": ("ssim",),
    "reference": ("name", "meaning", "allowed", "default", "keys"),
    "result": _RESULT,
    "revision": (*_REVISION, "actions", "placements"),
    "robot": _HOST_DETAILS,
    "simulation": ("scenario", "reference", "assumptions", "notes", "answer", "comparisons", "schemes"),
    "task": _TASK_DETAILS,
    "validation": ("edge_names", "robot_names", "task_names", "inventory_digest", "tasks_digest"),
    "version": ("edgectl", "python"),
}  # fmt: skip

# Key of an object, of a list of objects or of a map of objects -> keys of those objects.
INNER_KEYS: KeysByName = {
    **{
        resource.name: tuple(
            f"{amount}_{resource.unit.name}"
            for amount in ("used", "demand", "excess", "capacity")
            if not (resource.per_link and amount == "capacity")
            and not (resource.optional and amount == "excess")
        )
        for resource in RESOURCES
    },
    "actions": _ACTION,
    "carried": ("host", "size_bytes", "sent_bytes", "sha256", "save_s", "transfer_s", "load_s", "age_s"),
    "contributions": ("term", "weight", "here", "there", "adds"),
    "decision": ("action", "reason", "host", "previous_host", "total", "lead"),
    "other_tasks": _OTHER_TASK,
    "foreign_tasks": _OTHER_TASK,
    "declared": ("amount", "relative", "until_measured"),
    "device": ("load_1m", "temperature_c", "gpu_share", "power_w", "boot_id", "clock_skew_s", "interfaces"),
    "events": _EVENT,
    "flips": ("change", "term", "host", "robot", "amount", "unit", "size", "winner", "moves_first"),
    "moves_first": ("task", "host", "amount"),
    "handoff": ("order", "safe_when", "hold", "release", "save", "load", "topic"),
    "history": ("at", "host", *map(get_flat_used_key, RESOURCES)),
    "hosts": ("status", "sample_age_s", "error", *(resource.name for resource in HOST_RESOURCES)),
    "interfaces": (
        "rx_bytes_per_s", "tx_bytes_per_s", "speed_bytes_per_s", "level_dbm", "retries_per_s", "access_point",
        "joined_s",
    ),
    "latency": (
        "count", "misses", "bound_ms", "p50_ms", "p95_ms", "p99_ms", "max_ms", "recent_s", "recent_count",
        "recent_misses", "age_s", "error",
    ),
    "left": ("task", "host"),
    "links": _LINK_SAMPLE,
    "maps": _ESTIMATE,
    "needs": ("task", "until"),
    "object": tuple(dict.fromkeys((*_TASK, *_HOST, *_LINK))),
    "passes": _RESULT,
    "pending": ("task", "action", "host", "previous_host"),
    "phases": ("phase", "host", "duration_s", "ok", "detail"),
    "pin": ("pinned_to", "pinned_at", "pinned_until"),
    "placement": ("host", "placed_at"),
    "latencies": (
        "p50_ms", "p95_ms", "p99_ms", "low_ms", "high_ms", "service_ms", "host_load", "waiting_ms",
        "transfer_ms", "rtt_ms", "elsewhere",
    ),
    "resources": ("declared", "p50", "p95", "max"),
    "robot_counters": (
        "addresses", "counted", "rx_bytes", "tx_bytes", "tcp_bytes", "rx_bytes_per_s", "tx_bytes_per_s",
    ),
    "runs": tuple(dict.fromkeys((*_RUN, *_ABSENT_TASK))),
    "standbys": (
        *(*_RUN, "standby", "action", "reason", "total"),
        *("task", "outcome", "duration_s", "error", "hint"),
    ),
    "schemes": (
        "scheme", "run_count", "unfinished", "unplaced", "host_names", "figures", "metrics", "maps",
        "mission_events", "recoveries", "reference_figures", "off_by", "mission_s", "half_ci95", "handoffs",
    ),
    "comparisons": (
        "metric", "scheme", "base", "pair_count", "missing_pair_count", "difference", "ratio", "p", "p_holm",
        "effect", "bound", "equal_p", "equal_p_holm",
    ),
    "difference": _INTERVAL,
    "ratio": _INTERVAL,
    "mission_events": ("event_name", "kind", "subject", "run_count", "begin_s", "failures", *_RECOVERY),
    "recoveries": _RECOVERY,
    "spec": (
        "template", "task_kind", "managed", "command", "image", "node_names", "robot_names", "needs",
        "priority", "deadline_s", "hard_deadline", "labels", "restart", "handoff", "on_unreachable", "env",
    ),
    "utilisation": ("mean", "peak"),
}  # fmt: skip

# Key of a map -> keys of the objects in its lists.
LISTED_KEYS: KeysByName = {"figures": _ESTIMATE}
# Maps whose values are numbers, and those whose values are lists of numbers; of other maps without keys in
# the tables above, texts. The metrics of a task are numbers, those of a scheme estimates.
NUMBER_MAPS = frozenset({"counts", "limits"})
NUMBER_LIST_MAPS = frozenset({"downtimes_s", "off_by", "reference_figures"})
ESTIMATE_MAPS: KeysByName = {"metrics": _ESTIMATE}
