# SPDX-License-Identifier: Apache-2.0
"""Check of the container engines of a host."""

from collections.abc import Mapping

from edgectl.model.diagnosis import EngineFacts, Finding, Severity
from edgectl.model.image import ContainerEngine

_CHECK = "containers"
_SWARM = ContainerEngine.SWARM.value


def diagnose_engines(host: str, user: str, engines: Mapping[str, EngineFacts] | None) -> list[Finding]:
    """Whether tasks with an image can run on the host; nothing where no task has one."""
    if engines is None:
        return []
    if not engines:
        message = "neither docker nor podman is installed: no task with an image runs here"
        return [_build_warning(host, message, f"on {host}: sudo apt-get install docker.io")]
    usable = {name: facts for name, facts in engines.items() if not facts.error}
    message = ", ".join(f"{name} {facts.version}" for name, facts in usable.items())
    found = [Finding(host=host, check=_CHECK, level=Severity.OK, message=message, remedy="")]
    # A swarm is asked for only where a task needs it; of the others one is enough.
    failing = [name for name in engines if name not in usable and (not usable or name == _SWARM)]
    return (found if usable else []) + [
        _build_warning(host, f"{name}: {error}", _find_remedy(host, user, name, error))
        for name, error in ((name, engines[name].error) for name in failing)
    ]


def _build_warning(host: str, message: str, remedy: str) -> Finding:
    return Finding(host=host, check=_CHECK, level=Severity.WARNING, message=message, remedy=remedy)


def _find_remedy(host: str, user: str, engine: str, error: str) -> str:
    if "permission denied" in error.lower():
        return f"on {host}: sudo usermod -aG docker {user}, then log in again"
    if engine == _SWARM and "manager" in error:
        return (
            f"on {host}: docker context create lab --docker host=ssh://USER@MANAGER; in the inventory: "
            "swarm: [lab]"
        )
    if engine == _SWARM:
        return f"on {host}: docker swarm join, with the words of docker swarm join-token worker"
    if engine == "docker":
        return f"on {host}: sudo systemctl enable --now docker"
    return f"on {host}: podman version"
