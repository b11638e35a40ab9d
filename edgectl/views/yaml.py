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


def _yaml_from_json(text: str) -> str:
    document: Any = json_text.loads(text)
    return str(
        yaml.dump(
            document,
            Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper),
            sort_keys=False,
            allow_unicode=True,
            width=4096,
        )
    )


def _make_yaml_renderer(function: Any) -> Any:  # noqa: ANN401
    def form(*values: object) -> str:
        return _yaml_from_json(function(*values))

    form.__doc__ = function.__doc__
    return form


plan = _make_yaml_renderer(json_view.plan)
replayed = _make_yaml_renderer(json_view.replayed)
simulated = _make_yaml_renderer(json_view.simulated)
events = _make_yaml_renderer(json_view.events)
explanation = _make_yaml_renderer(json_view.explanation)
profile = _make_yaml_renderer(json_view.profile)
profilers = _make_yaml_renderer(json_view.profilers)
diagnosis = _make_yaml_renderer(json_view.diagnosis)
snapshot = _make_yaml_renderer(json_view.snapshot)
status = _make_yaml_renderer(json_view.status)
results = _make_yaml_renderer(json_view.results)
validated = _make_yaml_renderer(json_view.validated)
nothing = _make_yaml_renderer(json_view.nothing)
commands = _make_yaml_renderer(json_view.commands)
fields = _make_yaml_renderer(json_view.fields)
history = _make_yaml_renderer(json_view.history)
revision = _make_yaml_renderer(json_view.revision)
bandwidth = _make_yaml_renderer(json_view.bandwidth)
measured = _make_yaml_renderer(json_view.measured)
ssim = _make_yaml_renderer(json_view.ssim)
drained = _make_yaml_renderer(json_view.drained)
listing = _make_yaml_renderer(json_view.listing)
top_hosts = _make_yaml_renderer(json_view.top_hosts)
top_tasks = _make_yaml_renderer(json_view.top_tasks)
host_details = _make_yaml_renderer(json_view.host_details)
task_details = _make_yaml_renderer(json_view.task_details)
