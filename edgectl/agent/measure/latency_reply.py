# SPDX-License-Identifier: Apache-2.0
"""Latencies in the reply to a probe: from the files of those who count, who are given their rules here."""

import os
import time

from ..link import protocol
from ..link.fast_json import Document
from ..supervise import records, state_dir
from .latency import LatencyCounter, describe_error, get_rule_path, load_counts

# A reply has room for so many buckets of all tasks; what does not fit is left out, the tasks that come last
# first.
_MOST_BUCKETS = 20000


def read_latencies(host: str, rules: "list[Document]", tasks: "dict[str, Document]") -> "dict[str, Document]":
    """Read task -> counts, and give the rules to those that count.

    ``tasks``: the tasks of this host as they are replied.
    """
    found: "dict[str, Document]" = {}
    topics = [rule for rule in rules if rule.get("topic") and _is_wanted(rule, tasks)]
    if topics:
        from ..ros.latency_topics import read_topics

        found.update(read_topics(host, topics))
    for rule in rules:
        task = str(rule["task"])
        if rule.get("metric") and task in tasks and tasks[task]["managed"]:
            found[task] = _read_task(host, task, tasks[task], rule)
    return _limit_buckets(found)


def _is_wanted(rule: Document, tasks: "dict[str, Document]") -> bool:
    """Whether a topic is to be counted: for a task of this host only while it lives here."""
    entry = tasks.get(str(rule["task"]))
    return not rule["here"] or (entry is not None and entry["state"] in protocol.ALIVE_STATES)


def _read_task(host: str, task: str, entry: Document, rule: Document) -> Document:
    """Read the counts of an instance whose supervisor counts the values of a metric.

    What an ended one wrote last, before its supervisor knew the rule, is counted here.
    """
    instance = entry["instance"]
    for folder in state_dir.find_task_dirs(host, task):
        if records.read_record(os.path.join(folder, "instance")).get("instance") != instance:
            continue
        wanted = {"metric": rule["metric"], "bound_ms": rule.get("bound_ms")}
        if records.read_record(get_rule_path(folder)) != wanted:
            try:
                records.write_record(get_rule_path(folder), wanted)
            except OSError as error:
                return describe_error("no latency: %s" % (error.strerror or error))
        if entry["state"] in protocol.FINAL_STATES:
            from .latency_tail import LatencyTail

            LatencyTail(folder, instance).poll()
        known = load_counts(folder)
        if known.get("instance") == instance and known.get("metric") == rule["metric"]:
            return LatencyCounter(known).describe(time.monotonic())
    return LatencyCounter().describe(time.monotonic())


def _limit_buckets(found: "dict[str, Document]") -> "dict[str, Document]":
    room, kept = _MOST_BUCKETS, {}
    for task in sorted(found):
        room -= len(found[task]["buckets"]) + len(found[task]["recent"])
        if room < 0:
            break
        kept[task] = found[task]
    return kept
