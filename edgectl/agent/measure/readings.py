# SPDX-License-Identifier: Apache-2.0
"""Operation ``readings``: probes one after the other; what changed beyond its noise is sent (ADR 169).

The first reply is a whole one. A later one has ``changed``: the keys that differ from what was sent before,
by more than the noise, and ``entries``: of a key that has an entry for each name, those that differ; or it is
empty, now and then: everything is as it was. Some numbers wait until then (ADR 212), and until a profiler has
a new sample all do that have a noise.
"""

import _signal as signal
import os
import select
import time

from ..link import protocol
from ..link.fast_json import Document, dumps
from .link_meter import LinkMeter
from .probe import WindowMeter, probe_again, probe_host

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from ..link.boot import Channel

# Noise of a reading by its key: in its unit, and as a share of it. Plans ignore more (`rules.slack`). One
# acknowledgement that waits for data adds 5 ms, an eighth of 40, to the kernel's mean of round-trip times.
_NOISE = {
    "used_cores": (0.05, 0.02),
    "used_bytes": (float(1 << 20), 0.01),
    "rx_bytes_per_s": (10e3, 0.05),
    "tx_bytes_per_s": (10e3, 0.05),
    "other_bytes_per_s": (10e3, 0.05),
    "carries_bytes_per_s": (10e3, 0.05),
    "radio_bytes_per_s": (10e3, 0.05),
    "rtt_ms": (2.0, 0.2),
    "load_1m": (0.2, 0.1),
    "temperature_c": (1.0, 0.0),
    "gpu_share": (0.02, 0.0),
    "used_watts": (0.5, 0.05),
    "level_dbm": (2.0, 0.0),
    "retries_per_s": (5.0, 0.2),
}
# The traffic of a task by robot: its keys are names.
_TRAFFIC_KEY, _TRAFFIC_NOISE = "links", (10e3, 0.05)
# Numbers that are no reason to send: without a new sample of a profiler; of what no plan is made; and of what
# may be the same.
_SAMPLED_KEYS = frozenset([*_NOISE, _TRAFFIC_KEY])
_SHOWN_KEYS = frozenset(["load_1m"])
_SHOWN_AND_CPU_KEYS = _SHOWN_KEYS | {"used_cores"}
# Most kernels have 250 ticks a second, and count the CPU in use by who has it at each of them.
_TICK_S = 0.004
# Seconds, which go on by themselves; another beginning differs by more.
_AGE_KEYS, _AGE_NOISE_S = ("age_s", "ended_s", "joined_s", "wall"), 0.5
# Of the measurement itself; and what has names of others as its keys, and no noise.
_IGNORED_KEYS, _EXACT_KEYS = ("window_s", "sample_age_s"), ("metrics", "latencies", "totals")
# Addresses of names, and limits of control groups, are looked up anew after so long (s).
_LOOK_UP_EACH_S = 30.0
# What the last probe of many may take (s).
_LAST_REPLY_S = 30.0


def measure_once(request: Document) -> Document:
    """Reply as to a probe: a call has one reply. It loads this module, so that its code is kept."""
    return probe_host(request)


def send_readings(request: Document, channel: "Channel") -> None:
    """Reply to a probe, and measure again each ``every_s`` until there were ``rounds``, or nobody reads.

    A request for no rounds is a heartbeat alone.

    OSError where the reader has gone.
    """
    if not request["rounds"]:
        channel.reply(b"{}")
        return
    every, rounds, began = float(request["every_s"]), int(request["rounds"]), time.monotonic()
    # Windows without gaps: half the reads, and what is short counts too.
    meter, looked_up_at = WindowMeter(request, LinkMeter(request)), began
    base, base_sample = probe_again(request, meter), meter.sample_at
    base_at = said_at = time.monotonic()
    channel.reply(dumps(base).encode("ascii"))
    # The deadline was that of the first reply.
    signal.setitimer(signal.ITIMER_REAL, rounds * every + _LAST_REPLY_S)
    for number in range(1, rounds):
        # What took too long is not made up for.
        _pause(channel.fd, max(began + number * every, time.monotonic() + every / 2))
        if time.monotonic() - looked_up_at >= _LOOK_UP_EACH_S:
            meter.close()
            meter, looked_up_at = WindowMeter(request, LinkMeter(request)), time.monotonic()
        now = probe_again(request, meter)
        at = time.monotonic()
        is_due = at - said_at + every / 2 >= protocol.READING_SAID_S
        is_new = not meter.sample_at or meter.sample_at != base_sample
        waiting = list_waiting(base, now, is_new=is_new, is_due=is_due)
        said = build_update(base, now, at - base_at, waiting)
        if said:
            base, base_at, base_sample = merge_update(base, said), at, meter.sample_at
        elif not is_due:
            continue
        channel.reply(dumps(said).encode("ascii"))
        said_at = at


def _pause(fd: int, until: float) -> None:
    """Wait until then. OSError as soon as nobody reads what is written to ``fd``."""
    poll = select.poll()
    poll.register(fd, 0)
    if poll.poll(max(0.0, 1000 * (until - time.monotonic()))):
        raise BrokenPipeError(os.strerror(32))


def list_waiting(before: Document, now: Document, *, is_new: bool, is_due: bool) -> "frozenset[str]":
    """The keys of numbers that are no reason to send. ``is_new``: not of the same sample of a profiler;
    ``is_due``: something must be said.

    The CPU in use is one of them while it has changed by no more than ticks explain: they are a sample of
    the time, so two readings of the same load differ by twice the standard deviation of their difference, or
    less, 19 times of 20. Not where tasks are: plans weigh how much readings vary there (ADR 83).
    """
    if not is_new:
        return _SAMPLED_KEYS
    if is_due:
        return frozenset()
    was, found, ticks = before["cpu"]["used_cores"], now["cpu"], now["window_s"] / _TICK_S
    if now["tasks"] or not ticks or not found["cores"]:
        return _SHOWN_KEYS
    used = (was + found["used_cores"]) / 2
    variance = 2 * used * max(0.0, 1.0 - used / found["cores"]) / ticks
    return _SHOWN_AND_CPU_KEYS if (found["used_cores"] - was) ** 2 <= 4 * variance else _SHOWN_KEYS


def build_update(
    before: Document, now: Document, elapsed: float, waiting: "frozenset[str]" = frozenset()
) -> Document:
    """Build what is sent of the probe ``now``, ``elapsed`` s after what was sent ``before``: {} where it says
    the same.

    ``waiting``: keys of numbers that are sent only together with others. A key is sent where its value would
    be wrong as it was: by more than its noise, or an age by the time since.
    """
    if not _differs("", before, now, elapsed, waiting):
        return {}
    changed: Document = {}
    entries: Document = {}
    for key, value in now.items():
        if key not in before:
            changed[key] = value
        elif _differs(key, before[key], value):
            if _has_same_entries(before[key], value):
                entries[key] = _select_entries(before[key], value)
            else:
                changed[key] = value
    return {"changed": changed, "entries": entries, "gone": [key for key in before if key not in now]}


def _has_same_entries(before: "Any", now: "Any") -> bool:
    """Whether both are objects with an object for each of the same names."""
    return (
        isinstance(before, dict)
        and isinstance(now, dict)
        and before.keys() == now.keys()
        and all(isinstance(value, dict) for value in now.values())
    )


def _select_entries(before: Document, now: Document) -> Document:
    return {name: value for name, value in now.items() if _differs(name, before[name], value)}


def merge_update(before: Document, update: Document) -> Document:
    """What the manager knows, once an update has come."""
    merged = dict(
        {key: value for key, value in before.items() if key not in update["gone"]}, **update["changed"]
    )
    for key, entries in update["entries"].items():
        merged[key] = dict(before[key], **entries)
    return merged


def _differs(
    key: str, before: "Any", now: "Any", elapsed: float = 0.0, waiting: "frozenset[str]" = frozenset()
) -> bool:
    """Whether a value differs by more than its noise; ``key``: under which it stands. A number ``waiting``
    does not.
    """
    if before == now or key in _IGNORED_KEYS:
        return False
    if key in _EXACT_KEYS:
        return True
    if isinstance(before, dict) and isinstance(now, dict):
        return before.keys() != now.keys() or any(
            _differs(
                key if key == _TRAFFIC_KEY and not isinstance(value, dict) else name,
                before[name],
                value,
                elapsed,
                waiting,
            )
            for name, value in now.items()
        )
    if isinstance(before, list) and isinstance(now, list):
        return len(before) != len(now) or any(
            _differs(key, was, value, elapsed, waiting)
            for was, value in zip(before, now)  # noqa: B905 - valid for Python 3.6
        )
    if not (_is_number(before) and _is_number(now)):
        return True
    if key in _AGE_KEYS:
        return bool(abs(now - before - elapsed) > _AGE_NOISE_S)
    amount, share = _TRAFFIC_NOISE if key == _TRAFFIC_KEY else _NOISE.get(key, (0.0, 0.0))
    return key not in waiting and bool(abs(now - before) > max(amount, share * abs(before)))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
