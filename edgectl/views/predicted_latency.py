# SPDX-License-Identifier: Apache-2.0
"""Predicted latencies of an explanation: milliseconds, and what each part costs."""

from collections.abc import Sequence

from edgectl.formats.codec import encode
from edgectl.formats.document import Document
from edgectl.model.assignment import RankedHost
from edgectl.model.explanation import Explanation
from edgectl.model.predicted_latency import PredictedLatency
from edgectl.views.text import RenderOptions, wrap_text


def render_latencies(value: Explanation, look: RenderOptions, *, every: bool) -> str:
    """One line for the chosen host and one for the runner-up; ``every``: for every host with a prediction."""
    lines = (
        f"{entry.host}: {describe_latency(entry.predicted_latency, value.deadline_ms)}"
        for entry in _list_predicted(value)
        if entry.predicted_latency is not None
        and (every or entry.host in (value.decision.host, value.runner_up))
    )
    return "".join(wrap_text(line, look) for line in lines)


def describe_latency(predicted: PredictedLatency, deadline_ms: float | None) -> str:
    """``51 ms at p95 of 100 ms (p50 45, p99 60): 31 ms service at 60% load, 12 ms transfer, 4 ms rtt``."""
    bound = "" if deadline_ms is None else f" of {deadline_ms:.0f} ms"
    waiting = f" + {predicted.waiting_ms:.0f} ms waiting" if predicted.waiting_ms >= 0.5 else ""
    parts = [f"{predicted.service_ms:.0f} ms service{waiting} at {predicted.host_load:.0%} load"]
    if predicted.transfer_ms or predicted.rtt_ms:
        parts += [f"{predicted.transfer_ms:.0f} ms transfer", f"{predicted.rtt_ms:.0f} ms rtt"]
    elsewhere = "; service time of another class of hosts" if predicted.elsewhere else ""
    percentiles = f"(p50 {predicted.p50_ms:.0f}, p99 {predicted.p99_ms:.0f})"
    return f"{predicted.p95_ms:.0f} ms at p95{bound} {percentiles}: {', '.join(parts)}{elsewhere}"


def encode_latencies(value: Explanation) -> Document:
    """The predictions by host, and the deadline."""
    found = {
        entry.host: encode(entry.predicted_latency)
        for entry in _list_predicted(value)
        if entry.predicted_latency is not None
    }
    deadline = value.deadline_ms
    return {"deadline_s": None if deadline is None else deadline / 1000.0, "latencies": found}


def _list_predicted(value: Explanation) -> Sequence[RankedHost]:
    return [entry for entry in value.decision.ranking if entry.predicted_latency is not None]
