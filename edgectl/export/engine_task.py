# SPDX-License-Identifier: Apache-2.0
"""Tasks at the hosts of a plan, as other engines are given them (ADR 157)."""

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.errors import UsageError
from edgectl.model.check import Check, CheckLocation
from edgectl.model.image import ContainerImage
from edgectl.model.inventory import Host
from edgectl.model.secret import Secret
from edgectl.model.task import NeedCondition, Task, TaskKind

# Seconds between two questions of a probe.
PROBE_PERIOD_S = 5.0
_MAX_LABEL = 63
_INSIDE = re.compile(r"""(?:docker|podman) exec (?:-[it]+ )?"?\$\{?EDGECTL_CONTAINER\}?"? (.+)""", re.DOTALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineNeed:
    """A predecessor: its label, its host, and the state that it must reach."""

    label: str
    host: str
    until: NeedCondition


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineTask:
    """One task that the plan places.

    ``label``: its name of lower-case letters, digits and hyphens, unique among the tasks. ``env``: as it
    would have at ``host``; secrets are masked. ``demand``: by resource of hosts, in its unit. ``image``: what
    it runs in, None: on the host itself.
    """

    task: Task
    host: Host
    label: str
    env: Mapping[str, str]
    demand: Mapping[str, float]
    image: ContainerImage | None
    needs: tuple[EngineNeed, ...] = ()

    @property
    def completes(self) -> bool:
        """Whether it ends by itself."""
        return self.task.kind is TaskKind.JOB


@dataclass(slots=True, kw_only=True)
class EngineFiles:
    """Documents (or texts) by file name, and what they lack, by tasks."""

    files: dict[str, object] = field(default_factory=dict)
    lacking: dict[str, list[str]] = field(default_factory=dict)

    def add_note(self, each: EngineTask, message: str) -> None:
        """Note that the files of one task lack something."""
        self.lacking.setdefault(message, []).append(each.task.name)

    @property
    def notes(self) -> list[str]:
        """A line for each thing that is not carried over, with its tasks."""
        return [f"{', '.join(tasks)}: {message}" for message, tasks in self.lacking.items()]


def build_labels(names: Iterable[str]) -> dict[str, str]:
    """The label of each name, which engines take as part of a DNS name.

    Raises:
        UsageError: two names have the same.
    """
    found: dict[str, str] = {}
    for name in names:
        label = re.sub(r"[^a-z0-9]+", "-", name.lower())[:_MAX_LABEL].strip("-")
        other = next((other for other, taken in found.items() if taken == label), None)
        if other is not None:
            raise UsageError(
                f"{other} and {name} are both {label} as a name of this engine",
                hint="rename one of the two tasks; only letters, digits and hyphens count",
            )
        found[name] = label
    return found


def check_images(tasks: Sequence[EngineTask], engine: str) -> None:
    """Check that each task has an image, which ``engine`` cannot run without.

    Raises:
        UsageError: it names the tasks that have none.
    """
    bare = [each.task.name for each in tasks if each.image is None]
    if bare:
        raise UsageError(
            f"no image: {', '.join(bare)}; {engine} runs containers",
            hint="add image: NAME to the task, or pass --image NAME for all tasks without one",
        )


def select_probe(check: Check | None) -> str | None:
    """The command of a check that the engine can ask; None where it cannot.

    An engine asks in the container. edgectl does so by ``docker exec "$EDGECTL_CONTAINER" ..``, of which the
    command alone is returned.
    """
    if check is None or check.ros is not None or check.on is not CheckLocation.HOST:
        return None
    inside = _INSIDE.fullmatch(check.command)
    if inside is None:
        return check.command
    try:
        words = shlex.split(inside[1])
    except ValueError:
        return inside[1]
    return words[2] if words[:2] == ["sh", "-c"] and len(words) == 3 else inside[1]


def note_common_gaps(files: EngineFiles, each: EngineTask, *, secrets: str) -> None:
    """Note what no engine takes over of a task. ``secrets``: where this one expects their values."""
    task = each.task
    if any(isinstance(value, Secret) for value in each.env.values()):
        files.add_note(each, f"secrets are expected in {secrets}")
    if each.image is not None and each.image.args:
        files.add_note(each, "args of the image are left out")
    asked = (task.ready, task.alive.check if task.alive is not None else None)
    if any(check is not None and select_probe(check) is None for check in asked):
        files.add_note(each, "checks of a robot or of the ROS graph are left out")
    if each.image is not None and any(
        check is not None and select_probe(check) == check.command and check.command for check in asked
    ):
        files.add_note(each, "checks are asked in the container; edgectl asks them on the host")
    if task.env_command or each.host.env_command:
        files.add_note(each, "what env_command prints is left out")
    if task.done_when is not None:
        files.add_note(each, "done_when is left out: only edgectl asks it")
    if task.stop.preset is not None:
        files.add_note(
            each, f"stop: {task.stop.preset} is left out: its signal goes to all processes at once"
        )
    if task.standby is not None or task.state is not None:
        files.add_note(each, "standby copies and state are left out")
