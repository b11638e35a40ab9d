# SPDX-License-Identifier: Apache-2.0
"""The values of the page of ``edgectl serve``: problems, tasks, hosts, links and the last moves."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document, without_none
from edgectl.model.assignment import Shortage
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan, Step
from edgectl.model.resource import MEASURED_HOST_RESOURCES
from edgectl.model.result import ActionResult
from edgectl.model.revision import Revision
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Tasks
from edgectl.units import format_instant
from edgectl.views.output import OUTPUT_VERSION, round_item
from edgectl.views.plan_sections import list_plan_notes
from edgectl.views.reasons import describe_reason
from edgectl.views.results import encode_action_result
from edgectl.views.rows import encode_host_usage, encode_link_sample
from edgectl.views.state import format_operator_mark
from edgectl.views.status import StatusView

# Of the last actions that took time; an older one is in edgectl history.
MAX_MOVES = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetPicture:
    """One probe with the plan that an apply would make of it, and all revisions, oldest first.

    ``plan`` is None where none can be made, for the reason ``plan_error``.
    """

    snapshot: Snapshot
    inventory: Inventory
    tasks: Tasks
    plan: Plan | None = None
    plan_error: str = ""
    shortages: Sequence[Shortage] = ()
    revisions: Sequence[Revision] = field(default=())


class FleetPage:
    """The document of the page; its ``tasks`` are the items of ``edgectl status -o json`` without the output
    of tasks.
    """

    def __init__(self, picture: FleetPicture) -> None:
        self._picture = picture
        self._snapshot = remove_task_output(picture.snapshot)
        self._status = StatusView(self._snapshot, picture.inventory, picture.tasks, picture.shortages)
        plan = picture.plan
        self._steps = {} if plan is None else {step.task: step for step in plan.steps}

    def build_document(self) -> Document:
        """The page as JSON types: ``{format_version, kind, item, warnings}``."""
        item = round_item(self._build_item())
        return {
            "format_version": OUTPUT_VERSION,
            "kind": "fleet-page",
            "item": item,
            "warnings": self._list_warnings(),
        }

    def _build_item(self) -> Document:
        return {
            "fleet": self._picture.inventory.fleet,
            "taken_at": format_instant(self._snapshot.taken_at),
            "problems": self._status.list_problems(),
            "changes": [describe_change(step) for step in self._steps.values() if step.changes],
            "plan_error": self._picture.plan_error or None,
            "tasks": [row | self._encode_reason(str(row["task"])) for row in self._status.items()],
            "hosts": list(self._list_hosts()),
            "links": list(self._list_links()),
            "moves": _list_moves(self._picture.revisions),
        }

    def _list_warnings(self) -> list[str]:
        """Those of the status and of the plan that are no problems."""
        plan = self._picture.plan
        lines = [*self._status.warnings(), *(list_plan_notes(plan) if plan is not None else ())]
        above = self._status.list_problems()
        return [line for line in dict.fromkeys(lines) if line not in above]

    def _encode_reason(self, task: str) -> Document:
        step = self._steps.get(task)
        if step is None:
            return {}
        decision = step.decision
        return without_none(
            action=step.action.value,
            next_host=decision.host,
            total=decision.total,
            lead=decision.lead,
            reason=describe_reason(step),
        )

    def _list_hosts(self) -> Iterator[Document]:
        manager = self._snapshot.manager or ManagerState()
        reserved = _sum_reservations(self._steps.values())
        for name, host in self._picture.inventory.hosts.items():
            sample = self._snapshot.hosts.get(name)
            contact = manager.contact.get(name)
            silent = None if contact is None else max(0.0, self._snapshot.taken_at - contact)
            yield without_none(
                host=name,
                role=host.role.value,
                status="not probed" if sample is None else sample.status.value,
                mark=format_operator_mark(name, manager) or None,
                **({} if sample is None else _encode_sample(sample, reserved.get(name, {}))),
                silent_s=None if sample is None or sample.ok else silent,
            )

    def _list_links(self) -> Iterator[Document]:
        plan = self._picture.plan
        for edge, sample in self._snapshot.hosts.items():
            after = plan.expected.get(edge) if plan is not None else None
            for robot, link in sample.links.items():
                expected = after.links.get(robot, 0.0) if after is not None else None
                yield {"edge": edge, "robot": robot} | without_none(
                    **encode_link_sample(link), expected_bytes_per_s=expected
                )


def remove_task_output(snapshot: Snapshot) -> Snapshot:
    """The snapshot without the last lines that tasks printed, which a page on a wall does not show."""
    hosts = {
        name: replace(host, tasks={task: replace(run, log_tail=()) for task, run in host.tasks.items()})
        for name, host in snapshot.hosts.items()
    }
    return replace(snapshot, hosts=hosts)


def describe_change(step: Step) -> str:
    """One line on a step that an apply would carry out now."""
    return f"{step.task}: {describe_reason(step)}"


def _encode_sample(sample: HostSample, reserved: Mapping[str, float]) -> Document:
    usage = {
        resource.name: {**measured, f"reserved_{resource.unit.name}": reserved.get(resource.name, 0.0)}
        for resource in MEASURED_HOST_RESOURCES
        if isinstance(measured := encode_host_usage(sample).get(resource.name), dict)
    }
    return {
        "error": sample.error or None,
        "hint": sample.hint or None,
        "sample_age_s": sample.sample_age_s if sample.ok else None,
        **usage,
        "task_names": [name for name, task in sample.tasks.items() if task.state.alive],
    }


def _sum_reservations(steps: Iterable[Step]) -> dict[str, dict[str, float]]:
    """By host and resource, the demands of the tasks that the plan puts there."""
    found: dict[str, dict[str, float]] = {}
    for step in steps:
        if step.decision.host is None:
            continue
        here = found.setdefault(step.decision.host, {})
        for rho in step.decision.demand:
            here[rho.resource.name] = here.get(rho.resource.name, 0.0) + rho.value
    return found


def _list_moves(revisions: Sequence[Revision]) -> list[Document]:
    """The last actions that have phases, the newest first."""
    found: list[tuple[Revision, ActionResult]] = []
    for revision in reversed(revisions):
        found += [(revision, action) for action in reversed(revision.actions) if action.phases]
        if len(found) >= MAX_MOVES:
            break
    return [
        {
            "revision": revision.number,
            "started_at": format_instant(revision.began_at),
            "verb": revision.verb,
            "user": revision.user,
            **encode_action_result(action),
        }
        for revision, action in found[:MAX_MOVES]
    ]
