"""Completed or given-up instances that an operator reopened: their hosts still know them, and they no longer count."""

from pathlib import Path

from edgectl.state.files import FORMAT_VERSION, Warn, load_or_set_aside, silent, write_json

_NAME = "reopened.json"
_MOST = 1000


def load_reopened(fleet_dir: Path, warn: Warn = silent) -> tuple[str, ...]:
    """The instances, oldest first."""
    return load_or_set_aside(fleet_dir / _NAME, _decode, (), warn)


def save_reopened(fleet_dir: Path, instances: tuple[str, ...]) -> None:
    """Replace them; the oldest are dropped beyond a thousand."""
    write_json(fleet_dir / _NAME, {"format_version": FORMAT_VERSION, "instances": list(instances[-_MOST:])})


def _decode(document: dict[str, object]) -> tuple[str, ...]:
    instances = document.get("instances")
    if not isinstance(instances, list) or not all(isinstance(instance, str) for instance in instances):
        raise ValueError("instances must be a list of strings")
    return tuple(instances)
