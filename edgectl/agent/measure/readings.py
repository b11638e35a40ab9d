# SPDX-License-Identifier: Apache-2.0
"""Operation ``readings``: probes one after the other; what changed beyond its noise is sent (ADR 169).

The first reply is a whole one. A later one has ``changed``: the keys that differ from what was sent before,
by more than the noise, and ``entries``: of a key that has an entry for each name, those that differ; or it is
empty, now and then: everything is as it was. Until a profiler has a new sample, numbers with a noise wait.
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
        is_new = not meter.sample_at or meter.sample_at != base_sample
        said = build_update(base, now, at - base_at, is_new)
        if said:
            base, base_at, base_sample = merge_update(base, said), at, meter.sample_at
        elif at - said_at + every / 2 < protocol.READING_SAID_S:
            continue
        channel.reply(dumps(said).encode("ascii"))
        said_at = at


def _pause(fd: int, until: float) -> None:
    """Wait until then. OSError as soon as nobody reads what is written to ``fd``."""
    poll = select.poll()
    poll.register(fd, 0)
    if poll.poll(max(0.0, 1000 * (until - time.monotonic()))):
        raise BrokenPipeError(os.strerror(32))


def build_update(before: Document, now: Document, elapsed: float, is_new: bool = True) -> Document:
    """Build what is sent of the probe ``now``, ``elapsed`` s after what was sent ``before``: {} where it says
    the same.

    ``is_new``: not of the same sample of a profiler; else numbers with a noise alone are no reason to send.
    A key is sent where its value would be wrong as it was: by more than its noise, or an age by the time
    since.
    """
    if not _differs("", before, now, elapsed, is_new):
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


def _differs(key: str, before: "Any", now: "Any", elapsed: float = 0.0, is_new: bool = True) -> bool:
    """Whether a value differs by more than its noise; ``key``: under which it stands. One that has a noise
    differs only where it ``is_new``.
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
                is_new,
            )
            for name, value in now.items()
        )
    if isinstance(before, list) and isinstance(now, list):
        return len(before) != len(now) or any(
            _differs(key, was, value, elapsed, is_new)
            for was, value in zip(before, now)  # noqa: B905 - valid for Python 3.6
        )
    if not (_is_number(before) and _is_number(now)):
        return True
    if key in _AGE_KEYS:
        return bool(abs(now - before - elapsed) > _AGE_NOISE_S)
    amount, share = _TRAFFIC_NOISE if key == _TRAFFIC_KEY else _NOISE.get(key, (0.0, 0.0))
    return (is_new or not amount) and bool(abs(now - before) > max(amount, share * abs(before)))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
