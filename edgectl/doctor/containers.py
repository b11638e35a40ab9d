# SPDX-License-Identifier: Apache-2.0
"""Check of the container engines of a host."""

from collections.abc import Mapping

from edgectl.model.diagnosis import EngineFacts, Finding, Severity

_CHECK = "containers"


def diagnose_engines(host: str, user: str, engines: Mapping[str, EngineFacts] | None) -> list[Finding]:
    """Whether tasks with an image can run on the host; nothing where no task has one."""
    if engines is None:
        return []
    if not engines:
        message = "neither docker nor podman is installed: no task with an image runs here"
        return [_build_warning(host, message, f"on {host}: sudo apt-get install docker.io")]
    usable = {name: facts for name, facts in engines.items() if not facts.error}
    if usable:
        message = ", ".join(f"{name} {facts.version}" for name, facts in usable.items())
        return [Finding(host=host, check=_CHECK, level=Severity.OK, message=message, remedy="")]
    return [
        _build_warning(host, f"{name}: {facts.error}", _find_remedy(host, user, name, facts.error))
        for name, facts in engines.items()
    ]


def _build_warning(host: str, message: str, remedy: str) -> Finding:
    return Finding(host=host, check=_CHECK, level=Severity.WARNING, message=message, remedy=remedy)


def _find_remedy(host: str, user: str, engine: str, error: str) -> str:
    if "permission denied" in error.lower():
        return f"on {host}: sudo usermod -aG docker {user}, then log in anew"
    if engine == "docker":
        return f"on {host}: sudo systemctl enable --now docker"
    return f"on {host}: podman version"
