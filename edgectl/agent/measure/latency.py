# SPDX-License-Identifier: Apache-2.0
"""Latency of tasks: every value counted in a sketch, since the start of the instance and of the last minutes.

Whoever sees the values (the supervisor of the task, or the reader of a topic) counts them and keeps the
counts in a file; a probe reads that file.
"""

import os

from ..link import fast_json, sketch
from ..link.fast_json import Document
from ..supervise import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Dict

    Buckets = Dict[int, int]

# The recent values are those of the running period and of the one before.
PERIOD_S = 60.0
_MOST_BYTES = 1 << 17
_RULE, _COUNTS = "latency-rule", "latency"


class _Period:
    """The values of one period."""

    __slots__ = ("buckets", "highest", "misses", "since")

    def __init__(self, since: float, known: "Document | None" = None) -> None:
        known = known or {}
        self.since = since
        self.buckets: "Buckets" = _decode_buckets(known.get("buckets"))
        self.misses, self.highest = int(known.get("misses", 0)), float(known.get("highest", 0.0))

    def save(self) -> Document:
        return {
            "since": self.since,
            "buckets": _encode_buckets(self.buckets),
            "misses": self.misses,
            "highest": self.highest,
        }


class LatencyCounter:
    """Counts of the values (ms) of one task; times are of the monotonic clock, which all processes share."""

    def __init__(self, known: "Document | None" = None) -> None:
        """``known``: what `save` gave, to go on from there."""
        known = known or {}
        self.count, self.misses = int(known.get("count", 0)), int(known.get("misses", 0))
        self.sum_ms, self.last = float(known.get("sum_ms", 0.0)), float(known.get("last", 0.0))
        self.buckets: "Buckets" = _decode_buckets(known.get("buckets"))
        self.periods = [_Period(float(each["since"]), each) for each in known.get("periods", [])]

    def add(self, value_ms: float, bound_ms: "float | None", now: float) -> None:
        """Count a value; above ``bound_ms`` it is a miss."""
        bucket, period = sketch.find_bucket(value_ms), self._find_period(now)
        self.buckets[bucket] = self.buckets.get(bucket, 0) + 1
        period.buckets[bucket] = period.buckets.get(bucket, 0) + 1
        period.highest = max(period.highest, value_ms)
        self.count += 1
        self.sum_ms += value_ms
        self.last = now
        if bound_ms is not None and value_ms > bound_ms:
            self.misses += 1
            period.misses += 1

    def _find_period(self, now: float) -> _Period:
        if not self.periods or now - self.periods[-1].since >= PERIOD_S:
            recent = [each for each in self.periods if now - each.since < 2 * PERIOD_S]
            self.periods = [*recent[-1:], _Period(now)]
        return self.periods[-1]

    def save(self) -> Document:
        """Encode all of it."""
        return {
            "count": self.count,
            "misses": self.misses,
            "sum_ms": round(self.sum_ms, 3),
            "last": self.last,
            "buckets": _encode_buckets(self.buckets),
            "periods": [each.save() for each in self.periods],
        }

    def describe(self, now: float) -> Document:
        """Describe it for a reply."""
        recent = [each for each in self.periods if now - each.since < 2 * PERIOD_S]
        return {
            "count": self.count,
            "misses": self.misses,
            "sum_ms": round(self.sum_ms, 3),
            "age_s": round(max(0.0, now - self.last), 2) if self.count else None,
            "buckets": _encode_buckets(self.buckets),
            "recent": _encode_buckets(sketch.merge_buckets(each.buckets for each in recent)),
            "recent_s": round(now - recent[0].since, 2) if recent else 0.0,
            "recent_misses": sum(each.misses for each in recent),
            "recent_max_ms": max([each.highest for each in recent], default=0.0),
        }


def _encode_buckets(buckets: "Buckets") -> "dict[str, int]":
    return {str(bucket): buckets[bucket] for bucket in sorted(buckets)}


def _decode_buckets(known: "dict[str, int] | None") -> "Buckets":
    return {int(bucket): int(count) for bucket, count in (known or {}).items()}


def save_counts(folder: str, document: Document) -> None:
    """Replace the file of the counts in ``folder``; where that fails, the old ones stay."""
    path = os.path.join(folder, _COUNTS)
    try:
        fd = records.open_private_file(path + ".new", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        try:
            os.write(fd, fast_json.dumps(document).encode("ascii"))
        finally:
            os.close(fd)
        os.rename(path + ".new", path)
    except OSError:
        pass


def load_counts(folder: str) -> Document:
    """Load the counts in ``folder``; empty where there are none."""
    try:
        fd = records.open_private_file(os.path.join(folder, _COUNTS), os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return {}
    try:
        known: Document = fast_json.loads(os.pread(fd, _MOST_BYTES, 0).decode("ascii"))
    except (OSError, ValueError):
        return {}
    else:
        return known
    finally:
        os.close(fd)


def get_rule_path(folder: str) -> str:
    """Path of what is to be counted of the task in ``folder``: a record."""
    return os.path.join(folder, _RULE)


def describe_error(why: str) -> Document:
    """Describe counts that cannot be had."""
    return dict(LatencyCounter().describe(0.0), error=why)
