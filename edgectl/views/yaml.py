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
    "nothing",
    "plan",
    "profile",
    "profilers",
    "results",
    "revision",
    "snapshot",
    "status",
    "task_details",
    "top_hosts",
    "top_tasks",
    "validated",
]


def yaml_from_json(text: str) -> str:
    """A JSON document as YAML."""
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
        return yaml_from_json(function(*values))

    form.__doc__ = function.__doc__
    return form


plan = _make_yaml_renderer(json_view.plan)
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
drained = _make_yaml_renderer(json_view.drained)
listing = _make_yaml_renderer(json_view.listing)
top_hosts = _make_yaml_renderer(json_view.top_hosts)
top_tasks = _make_yaml_renderer(json_view.top_tasks)
host_details = _make_yaml_renderer(json_view.host_details)
task_details = _make_yaml_renderer(json_view.task_details)
