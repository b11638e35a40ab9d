# SPDX-License-Identifier: Apache-2.0
"""Latency of a metric: counted by the supervisor, value by value, against the sender's own record."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.link import sketch
from edgectl.agent.measure import metrics
from edgectl.agent.measure.latency import PERIOD_S, LatencyCounter
from tests.agent.conftest import AgentHost, eventually

RULE = {"task": "cmd", "metric": "age_ms", "bound_ms": 20.0}
# Writes as many values, of which it keeps a record, and waits for the next order.
SENDER = """exec python3 -u -c '
import json, os, random, sys, time
draw, sent = random.Random({seed}), []
def write(count):
    with open(os.environ["EDGECTL_METRICS"], "a") as lines:
        for _ in range(count):
            sent.append(round(draw.lognormvariate(2.3, 0.6), 4))
            lines.write("age_ms %r\\nother 1\\n" % sent[-1])
    with open("{record}.new", "w") as record:
        json.dump(sent, record)
    os.rename("{record}.new", "{record}")
write({count})
while not os.path.exists("{record}.more"):
    time.sleep(0.02)
write({count})
time.sleep(600)
'"""


def ask_latency(host: AgentHost, rule: dict[str, Any] = RULE) -> dict[str, Any]:
    latencies = host.ask("probe", window_s=0.05, latency=[rule])["latencies"]
    found: dict[str, Any] = latencies["cmd"]
    return found


def find_exact(values: list[float], share: float) -> float:
    return sorted(values)[max(1, math.ceil(share * len(values) - 1e-9)) - 1]


def check_against_record(found: dict[str, Any], sent: list[float]) -> None:
    assert (found["count"], found["misses"]) == (len(sent), sum(value > 20.0 for value in sent))
    assert found["sum_ms"] == pytest.approx(sum(sent), abs=0.01)
    assert found["recent_max_ms"] == max(sent)
    for key in ("buckets", "recent"):
        for share in (0.5, 0.95, 0.99):
            quantile = sketch.find_quantile(
                {int(bucket): count for bucket, count in found[key].items()}, share
            )
            assert quantile == pytest.approx(find_exact(sent, share), rel=sketch.ERROR * 1.001)


def test_every_value_counts_once_and_percentiles_are_within_the_stated_error(
    host: AgentHost, tmp_path: Path
) -> None:
    record = tmp_path / "sent.json"
    host.start("cmd", SENDER.format(seed=7, count=3000, record=record))
    assert eventually(record.exists)
    assert eventually(lambda: ask_latency(host)["count"] == 3000)
    check_against_record(ask_latency(host), json.loads(record.read_text()))
    (tmp_path / "sent.json.more").touch()
    assert eventually(lambda: ask_latency(host)["count"] == 6000)
    check_against_record(ask_latency(host), json.loads(record.read_text()))


def test_values_of_all_processes_of_an_instance_count_and_of_a_new_one_alone(host: AgentHost) -> None:
    """A restart by the supervisor goes on; a start by edgectl begins at zero."""
    host.ask("probe", window_s=0.05)
    command = 'echo "age_ms 30" >>"$EDGECTL_METRICS"; sleep 0.5; [ "$EDGECTL_ROUND" ] || exit 1'
    host.start("cmd", command, restart="always")
    assert eventually(lambda: ask_latency(host)["count"] >= 2)
    found = ask_latency(host)
    assert found["misses"] == found["count"]
    host.stop("cmd")
    host.start("cmd", 'echo "age_ms 1" >>"$EDGECTL_METRICS"; exec sleep 600', instance="i2", generation=2)
    assert eventually(lambda: ask_latency(host)["count"] == 1)
    assert ask_latency(host)["misses"] == 0


def test_another_bound_counts_from_then_on_and_another_metric_anew(host: AgentHost) -> None:
    host.start("cmd", 'printf "age_ms 30\\nother_ms 5\\n" >>"$EDGECTL_METRICS"; exec sleep 600')
    assert eventually(lambda: ask_latency(host)["count"] == 1)
    assert ask_latency(host, {**RULE, "bound_ms": None})["misses"] == 1
    assert eventually(lambda: ask_latency(host, {**RULE, "metric": "other_ms"})["sum_ms"] == 5.0)


def test_a_cut_of_the_file_neither_loses_nor_repeats_values(host: AgentHost, tmp_path: Path) -> None:
    line, gate = b"age_ms 25.25\n", tmp_path / "gate"
    count = metrics.MAX_FILE_BYTES // len(line) + 1000
    write = f"yes 'age_ms 25.25' | head -n {count} >>\"$EDGECTL_METRICS\""
    host.start("cmd", f"until [ -e {gate} ]; do sleep 0.05; done; {write}; exec sleep 600")
    assert ask_latency(host)["count"] == 0
    gate.touch()
    assert eventually(lambda: ask_latency(host)["count"] == count)

    def is_cut() -> bool:
        return (host.folder("cmd") / "metrics").stat().st_size == len(line)

    assert eventually(is_cut)
    assert ask_latency(host)["count"] == count


def test_recent_values_are_those_of_the_last_two_periods() -> None:
    counter = LatencyCounter()
    for second in range(4 * int(PERIOD_S)):
        counter.add(10.0 if second < 3 * PERIOD_S else 50.0, 20.0, float(second))
    now = 4 * PERIOD_S - 1
    found = counter.describe(now)
    assert (found["count"], found["misses"]) == (240, 60)
    assert sum(found["recent"].values()) == 120
    assert (found["recent_misses"], found["recent_s"], found["recent_max_ms"]) == (60, 119.0, 50.0)
    assert LatencyCounter(counter.save()).describe(now) == found
    old = counter.describe(now + 3 * PERIOD_S)
    assert (old["count"], old["recent"], old["recent_s"], old["age_s"]) == (240, {}, 0.0, 180.0)


def test_a_job_that_has_ended_before_the_first_probe_is_counted(host: AgentHost) -> None:
    host.start("cmd", 'printf "age_ms 30\\nage_ms 10\\n" >>"$EDGECTL_METRICS"', kind="job")
    host.until("cmd", "completed")
    for _ in range(2):
        found = ask_latency(host)
        assert (found["count"], found["misses"], found["sum_ms"]) == (2, 1, 40.0)


def test_a_task_without_values_has_none(host: AgentHost) -> None:
    host.start("cmd", "exec sleep 600")
    found = ask_latency(host)
    assert (found["count"], found["age_s"], found["recent"]) == (0, None, {})
    assert host.ask("probe", window_s=0.05)["latencies"] == {}
