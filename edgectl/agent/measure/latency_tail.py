# SPDX-License-Identifier: Apache-2.0
"""Values of one metric as the task appends them to its metrics file: each is read once and counted."""

import os
import stat
import time

from ..supervise import records
from . import metrics
from .latency import LatencyCounter, get_rule_path, load_counts, save_counts

# So much is read at once; of a task that writes faster, the values in between are not counted.
_MOST_BYTES = 4 << 20


class LatencyTail:
    """The reader of one task; its supervisor calls it every few seconds and before the file is cut."""

    def __init__(self, folder: str, instance: str) -> None:
        known = load_counts(folder)
        known = known if known.get("instance") == instance else {}
        self.folder, self.instance = folder, instance
        self.metric, self.bound_ms = str(known.get("metric", "")), None  # type: str, float | None
        self.counter, self.offset = LatencyCounter(known), int(known.get("offset", 0))

    def poll(self) -> None:
        """Count what is new, by the rule as it is now."""
        self._take_rule()
        now, added = time.monotonic(), False
        for value in self._read_values():
            self.counter.add(value, self.bound_ms, now)
            added = True
        if added:
            self._save()

    def _save(self) -> None:
        kept = {"instance": self.instance, "metric": self.metric, "offset": self.offset}
        save_counts(self.folder, dict(self.counter.save(), **kept))

    def cut_to(self, size: int) -> None:
        """Go on at ``size``: the file was cut to it, and all that it kept was read."""
        self.offset = size

    def _take_rule(self) -> None:
        rule = records.read_record(get_rule_path(self.folder))
        bound = rule.get("bound_ms")
        self.bound_ms = None if bound is None else float(bound)
        metric = str(rule.get("metric", ""))
        if metric != self.metric:
            # The values of another metric are no continuation; those in the file are counted.
            self.metric, self.counter, self.offset = metric, LatencyCounter(), 0

    def _read_values(self) -> "list[float]":
        try:
            fd = records.open_private_file(metrics.get_metrics_path(self.folder), os.O_RDONLY | os.O_NONBLOCK)
        except OSError:
            return []
        try:
            return self._parse(self._read_new(fd))
        except OSError:
            return []
        finally:
            os.close(fd)

    def _read_new(self, fd: int) -> bytes:
        """Read the whole lines that were appended since."""
        info = os.fstat(fd)
        if not stat.S_ISREG(info.st_mode):
            return b""
        begin = self.offset if self.offset <= info.st_size else 0
        skipped = info.st_size - begin > _MOST_BYTES
        begin = info.st_size - _MOST_BYTES if skipped else begin
        data = os.pread(fd, _MOST_BYTES, begin)
        whole = data[: data.rfind(b"\n") + 1]
        self.offset = begin + len(whole)
        return whole.partition(b"\n")[2] if skipped else whole

    def _parse(self, data: bytes) -> "list[float]":
        name, found = self.metric.encode("ascii", "replace"), []
        for line in data.splitlines():
            words = line.split()
            if len(words) == 2 and words[0] == name:
                value = metrics.parse_value(words[1])
                if value is not None:
                    found.append(value)
        return found
