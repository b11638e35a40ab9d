"""The JSON documents in YAML, for eyes that prefer it."""

import json as json_text
from typing import Any

import yaml

from edgectl.views import json as json_view

__all__ = [
    "bandwidth",
    "commands",
    "diagnosis",
    "drained",
    "events",
    "explanation",
    "fields",
    "history",
    "host_details",
    "listing",
    "measured",
    "nothing",
    "plan",
    "profile",
    "profilers",
    "replayed",
    "results",
    "revision",
    "simulated",
    "snapshot",
    "ssim",
    "status",
    "task_details",
    "top_hosts",
    "top_tasks",
    "validated",
]


def _same(text: str) -> str:
    document: Any = json_text.loads(text)
    return str(yaml.dump(document, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False, allow_unicode=True, width=4096))


def _of(function: Any) -> Any:  # noqa: ANN401
    def form(*values: object) -> str:
        return _same(function(*values))

    form.__doc__ = function.__doc__
    return form


plan = _of(json_view.plan)
replayed = _of(json_view.replayed)
simulated = _of(json_view.simulated)
events = _of(json_view.events)
explanation = _of(json_view.explanation)
profile = _of(json_view.profile)
profilers = _of(json_view.profilers)
diagnosis = _of(json_view.diagnosis)
snapshot = _of(json_view.snapshot)
status = _of(json_view.status)
results = _of(json_view.results)
validated = _of(json_view.validated)
nothing = _of(json_view.nothing)
commands = _of(json_view.commands)
fields = _of(json_view.fields)
history = _of(json_view.history)
revision = _of(json_view.revision)
bandwidth = _of(json_view.bandwidth)
measured = _of(json_view.measured)
ssim = _of(json_view.ssim)
drained = _of(json_view.drained)
listing = _of(json_view.listing)
top_hosts = _of(json_view.top_hosts)
top_tasks = _of(json_view.top_tasks)
host_details = _of(json_view.host_details)
task_details = _of(json_view.task_details)
