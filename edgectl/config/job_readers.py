# SPDX-License-Identifier: Apache-2.0
"""Readers of what a task states of its jobs: the service time by class of hosts, and the bytes."""

from collections.abc import Mapping
from typing import Any

from edgectl.config.fields import record_reader
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import (
    INVALID,
    NAME_PATTERN,
    NodeReader,
    quantity_reader,
    read_duration,
    report_wrong_type,
)
from edgectl.config.schema import build_mapping_schema, build_object_schema, describe_as, get_reader_schema
from edgectl.model.predicted_latency import JobSize, ServiceTime
from edgectl.units import parse_bytes

# Key of a service time that holds on every class of hosts.
EVERY_CLASS = ""
SERVICE_TIME_KEYS: Mapping[str, NodeReader] = {"p50": read_duration, "p95": read_duration}
JOB_KEYS: Mapping[str, NodeReader] = {"in": quantity_reader(parse_bytes), "out": quantity_reader(parse_bytes)}


def _build_service_time(p50: float, p95: float | None = None) -> ServiceTime:
    return ServiceTime(p50=p50, p95=p50 if p95 is None else p95)


_read_spread = record_reader(SERVICE_TIME_KEYS, _build_service_time, "a service time", ("p50",))


@describe_as(
    lambda: {"anyOf": [get_reader_schema(read_duration), build_object_schema(SERVICE_TIME_KEYS, ("p50",))]}
)
def _read_one(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A time, or its median and 95th percentile."""
    if not isinstance(node.value, dict):
        found = read_duration(node, problems)
        return found if found is INVALID else ServiceTime(p50=found, p95=found)
    found = _read_spread(node, problems)
    if found is not INVALID and found.p95 < found.p50:
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            "p95 is less than p50",
            "write the median as p50, the longer as p95",
        )
        return INVALID
    return found


@describe_as(
    lambda: {
        "anyOf": [
            get_reader_schema(_read_one),
            build_mapping_schema(NAME_PATTERN.pattern, get_reader_schema(_read_one)),
        ]
    }
)
def read_service_time(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A service time for every class of hosts, or a mapping by class."""
    if not isinstance(node.value, dict) or SERVICE_TIME_KEYS.keys() & node.value.keys():
        found = _read_one(node, problems)
        return found if found is INVALID else {EVERY_CLASS: found}
    if not node.value:
        return report_wrong_type(node, problems, "must name a class of hosts", "write service_time: 30ms")
    by_class = {str(kind): _read_one(inner, problems) for kind, inner in node.value.items()}
    return INVALID if INVALID in by_class.values() else by_class


def _build_job(**sizes: float) -> JobSize:
    return JobSize(received=sizes.get("in", 0.0), sent=sizes.get("out", 0.0))


read_job = record_reader(JOB_KEYS, _build_job, "job")
