# SPDX-License-Identifier: Apache-2.0
"""The phases of each action and their requests, as one list: apply performs it, a dry run prints it. Pure."""

from collections.abc import Iterable, Mapping

from edgectl.dataclass import dataclass
from edgectl.errors import HostError
from edgectl.executor import host_requests
from edgectl.executor.dependencies import list_stop_hosts
from edgectl.model.assignment import Verdict
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Host, Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import Phase
from edgectl.model.snapshot import TaskSample, TaskState
from edgectl.model.task import Need, NeedCondition, Task, Tasks

# One wait request lasts at most so long, so that a lost connection is not mistaken for a slow task.
WAIT_PIECE_S = 15.0
# How long a command without a ready check must have run until it counts as ready: most that die at start do
# so within it (a missing library, a refused connection, a bad argument).
DEFAULT_UP_S = 3.0
# How long a task without a ready check may take beyond that: it may be restarted meanwhile.
DEFAULT_READY_S = 10.0
# How long a successor waits for a job to complete before it is left to the next apply.
COMPLETION_S = 30.0
# The grace of a task that left the task files, whose own grace is unknown here.
_UNKNOWN_GRACE_S = 40.0
# What the start, the answers and the hold of a start-first move may take besides becoming ready.
_LEAVING_MARGIN_S = 90.0
# Looks at a ROS 1 master before and after a stop.
_GRAPH_S = 10.0
# A container that is created and started on a busy host, and what its end takes beside the grace.
_CONTAINER_START_S, _CONTAINER_STOP_S = 120.0, 40.0
# The lease of a killed node of ROS 2 ends 20 s after the helper of the host has heard it last, and on a busy
# host that hears late. Nobody waits for longer than names are there.
_LEASE_S = 45.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedRequest:
    """A request to ``host`` with placeholders for instance, generation and secrets (0, 0 and ``***``).

    ``timeout_s``: how long the host may work on it, besides the time of a round trip.
    """

    host: Host
    body: host_requests.Request
    timeout_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedPhase:
    """One phase of an action: at least one request, sent in order to get ``task`` that far.

    ``timeout_s``: waits and checks are repeated for so long until they succeed; 0 where nothing is repeated.
    """

    phase: Phase
    task: str
    requests: tuple[PlannedRequest, ...]
    timeout_s: float = 0.0

    @property
    def host(self) -> Host:
        """The host that the phase counts for."""
        return self.requests[0].host


PlannedPhases = tuple[PlannedPhase, ...]


def build_stop_phases(step: Step, inventory: Inventory, tasks: Tasks) -> PlannedPhases:
    """What a step stops before anything starts.

    Raises:
        HostError: a host left the inventory.
    """
    task = tasks.tasks.get(step.task)
    # Where the task runs on elsewhere, its names stay.
    lease_s = _LEASE_S if step.action in (Action.STOP, Action.COMPLETE) else 0.0
    return tuple(
        build_stop_phase(step.task, task, host, inventory, instance=step.instances.get(host), lease_s=lease_s)
        for host in list_stop_hosts(step)
    )


def build_adopt_phases(step: Step, inventory: Inventory, tasks: Tasks) -> PlannedPhases:
    """The takeover of an orphan by a new supervisor; nothing for other steps.

    Raises:
        HostError: the host left the inventory.
    """
    task = tasks.tasks.get(step.task)
    if step.action is not Action.ADOPT or task is None:
        return ()
    host = get_host(inventory, step.decision.host or "")
    body = host_requests.build_takeover_request(task, host, inventory.hosts)
    request = PlannedRequest(host=host, body=body, timeout_s=get_start_time(task))
    return (PlannedPhase(phase=Phase.ADOPT, task=task.name, requests=(request,)),)


def build_reach_phase(task: str, host_name: str, inventory: Inventory) -> PlannedPhase:
    """Make sure that a host answers before anything is done for its sake."""
    host = get_host(inventory, host_name)
    request = PlannedRequest(host=host, body=host_requests.build_status_request(host))
    return PlannedPhase(phase=Phase.REACH, task=task, requests=(request,))


def build_leaving_phases(
    task: Task, host_name: str, step: Step, inventory: Inventory, *, seconds: float | None = None
) -> PlannedPhases:
    """Tell the old instance of a start-first move, where it may be a node of ROS, that its successor starts.

    ``seconds``: for how long at most; as long as that may take where it is None.
    """
    host = get_host(inventory, host_name)
    instance = step.instances.get(host_name)
    if host.ros is None or instance is None:
        return ()
    seconds = _get_ready_timeout(task) + _LEAVING_MARGIN_S if seconds is None else seconds
    body = host_requests.build_leaving_request(task.name, host, instance=instance, seconds=seconds)
    return (
        PlannedPhase(phase=Phase.REACH, task=task.name, requests=(PlannedRequest(host=host, body=body),)),
    )


def build_stop_phase(
    name: str,
    task: Task | None,
    host_name: str,
    inventory: Inventory,
    *,
    instance: str | None,
    lease_s: float = 0.0,
) -> PlannedPhase:
    """Stop a task on a host and have it proven gone; ``task`` is None where it left the files.

    ``lease_s``: how long a graph of ROS 2 is asked until it has forgotten the nodes.
    """
    host = get_host(inventory, host_name)
    lease_s = lease_s if host.ros is not None and host.ros.version == 2 else 0.0
    body = host_requests.build_stop_request(name, host, task=task, instance=instance, lease_s=lease_s)
    grace = task.stop.grace if task else _UNKNOWN_GRACE_S
    timeout_s = grace + lease_s + (_GRAPH_S if host.ros is not None else 0.0)
    timeout_s += _CONTAINER_STOP_S if task is not None and task.image is not None else 0.0
    return PlannedPhase(
        phase=Phase.STOP, task=name, requests=(PlannedRequest(host=host, body=body, timeout_s=timeout_s),)
    )


def build_run_phases(
    task: Task,
    host_name: str,
    inventory: Inventory,
    *,
    phase: Phase = Phase.START,
    replaces: tuple[str, ...] | None = None,
) -> PlannedPhases:
    """Start a task on a host and wait until it is ready by its own check (up for its time, where it has
    none). ``replaces``: addresses of nodes of an instance that runs meanwhile; None where none does.
    """
    host = get_host(inventory, host_name)
    body = host_requests.build_start_request(task, host, inventory.hosts, replaces=replaces)
    request = PlannedRequest(host=host, body=body, timeout_s=get_start_time(task))
    start = PlannedPhase(phase=phase, task=task.name, requests=(request,))
    return start, build_ready_phase(task, host, inventory)


def build_ready_phase(task: Task, host: Host, inventory: Inventory) -> PlannedPhase:
    """Wait on the host; a check on the robot is asked there, and its yes is marked on the host."""
    timeout = _get_ready_timeout(task)
    requests = [build_wait(task, host, host_requests.NO_INSTANCE, timeout)]
    if task.ready is not None and task.ready.on is CheckLocation.ROBOT:
        robot = _get_check_robot(task, inventory)
        body = host_requests.build_check_request(task, task.ready, robot, inventory.hosts)
        requests.append(PlannedRequest(host=robot, body=body, timeout_s=task.ready.timeout))
        mark = host_requests.build_mark_ready_request(task.name, host, instance=host_requests.NO_INSTANCE)
        requests.append(PlannedRequest(host=host, body=mark))
    return PlannedPhase(phase=Phase.READY, task=task.name, requests=tuple(requests), timeout_s=timeout)


def get_start_time(task: Task) -> float:
    """How long (s) a host may take to start the task, besides the time of a round trip."""
    return _CONTAINER_START_S if task.image is not None else 0.0


def get_up_time(task: Task) -> float:
    """How long (s) the command must have run until the task counts as ready; 0 where a check decides."""
    if task.ready is not None:
        return 0.0
    return DEFAULT_UP_S if task.up is None else task.up


def get_copy_up_time(task: Task) -> float:
    """How long (s) an inactive copy must have run until it can be activated; 0 where that can be asked."""
    rule = task.activation
    if rule is None or rule.ready is not None or rule.lifecycle is not None:
        return 0.0
    return DEFAULT_UP_S if task.up is None else task.up


def _get_ready_timeout(task: Task) -> float:
    return task.ready.timeout if task.ready else DEFAULT_READY_S + get_up_time(task)


def build_wait(
    task: Task, host: Host, instance: str, timeout_s: float, *, up_s: float | None = None
) -> PlannedRequest:
    """Wait on the host until an instance is ready; ``up_s``: of `build_wait_request`, None: the task's."""
    piece = min(WAIT_PIECE_S, timeout_s)
    up_s = get_up_time(task) if up_s is None else up_s
    body = host_requests.build_wait_request(task.name, host, instance=instance, timeout_s=piece, up_s=up_s)
    return PlannedRequest(host=host, body=body, timeout_s=piece)


def build_safe_phases(task: Task, host_name: str, inventory: Inventory) -> PlannedPhases:
    """Wait until a handoff is safe, at most its timeout."""
    rule = task.handoff.safe_when
    if rule is None:
        return ()
    host, timeout = _get_check_host(task, rule, host_name, inventory), task.handoff.timeout
    seconds = min(rule.timeout, timeout)
    body = host_requests.build_check_request(task, rule, host, inventory.hosts, timeout_s=seconds)
    request = PlannedRequest(host=host, body=body, timeout_s=seconds)
    return (PlannedPhase(phase=Phase.SAFE, task=task.name, requests=(request,), timeout_s=timeout),)


def build_hook_phases(
    phase: Phase, task: Task, rule: Check | None, host_name: str, inventory: Inventory
) -> PlannedPhases:
    """Run the hold or release hook, where there is one."""
    if rule is None:
        return ()
    host = _get_check_host(task, rule, host_name, inventory)
    body = host_requests.build_check_request(task, rule, host, inventory.hosts)
    request = PlannedRequest(host=host, body=body, timeout_s=rule.timeout)
    return (PlannedPhase(phase=phase, task=task.name, requests=(request,)),)


def build_need_phases(needs: Iterable[Need], plan: Plan, inventory: Inventory, tasks: Tasks) -> PlannedPhases:
    """A wait for each predecessor that neither the snapshot nor this plan settles.

    Raises:
        HostError: a predecessor does not run.
    """
    steps = {step.task: step for step in plan.steps}
    known = [need for need in needs if need.task in steps and need.task in tasks.tasks]
    waits = tuple(
        _build_need_phase(need, tasks.tasks[need.task], steps[need.task], inventory, plan)
        for need in known
        if not _is_predecessor_settled(need, tasks.tasks[need.task], steps[need.task], plan)
    )
    return (*waits, *_build_run_phases_of_needs(known, steps, inventory))


def _build_run_phases_of_needs(
    needs: Iterable[Need], steps: Mapping[str, Step], inventory: Inventory
) -> PlannedPhases:
    """Ask which run of each predecessor the task starts with, where it restarts with it."""
    hosts = {need.task: inventory.hosts.get(steps[need.task].decision.host or "") for need in needs}
    return tuple(
        PlannedPhase(
            phase=Phase.NEEDS,
            task=need.task,
            requests=(PlannedRequest(host=host, body=host_requests.build_status_request(host, need.task)),),
        )
        for need in needs
        if need.restart is not None and (host := hosts[need.task]) is not None
    )


def _is_predecessor_settled(need: Need, task: Task, step: Step, plan: Plan) -> bool:
    """Whether the snapshot shows the predecessor far enough, or no host can be asked about it."""
    if step.decision.verdict in (Verdict.COMPLETED, Verdict.HELD) or step.action in (
        Action.COMPLETE,
        Action.HOLD,
        Action.NONE,
    ):
        return True
    if not task.managed:
        return need.until is not NeedCondition.COMPLETED
    if need.until is NeedCondition.COMPLETED:
        return False
    if step.action in (Action.START, Action.MOVE, Action.RESTART):
        return True
    sample = _find_sample(plan, step)
    if sample is None:
        return False
    if sample.state is TaskState.RUNNING and task.ready is None and need.until is NeedCondition.READY:
        return plan.snapshot.taken_at - sample.started_at >= get_up_time(task)
    return sample.state is TaskState.READY or (
        sample.state in (TaskState.RUNNING, TaskState.UNHEALTHY) and need.until is NeedCondition.RUNNING
    )


def _find_sample(plan: Plan, step: Step) -> TaskSample | None:
    host = plan.snapshot.hosts.get(step.decision.host or "")
    return host.tasks.get(step.task) if host else None


def _build_need_phase(need: Need, task: Task, step: Step, inventory: Inventory, plan: Plan) -> PlannedPhase:
    """Wait for a predecessor that runs already, or for a job to complete."""
    host = inventory.hosts.get(step.decision.host or "")
    if host is None:
        raise HostError(f"waits for {need.task}, which does not run", hint="apply again once it does")
    if need.until is NeedCondition.COMPLETED:
        body = host_requests.build_status_request(host, need.task)
        request, timeout = PlannedRequest(host=host, body=body), COMPLETION_S
    else:
        sample, timeout = _find_sample(plan, step), _get_ready_timeout(task)
        request = build_wait(task, host, sample.instance if sample else "", timeout)
    return PlannedPhase(phase=Phase.NEEDS, task=need.task, requests=(request,), timeout_s=timeout)


def _get_check_host(task: Task, rule: Check, host_name: str, inventory: Inventory) -> Host:
    if rule.on is CheckLocation.ROBOT:
        return _get_check_robot(task, inventory)
    return get_host(inventory, host_name)


def _get_check_robot(task: Task, inventory: Inventory) -> Host:
    if not task.robots:
        raise HostError(f"{task.name} has no robot on which its check could run")
    robot = get_host(inventory, task.robots[0])
    if not robot.probe:
        raise HostError(
            f"the check of {task.name} needs {robot.name}, which is never contacted (probe: false)",
            host=robot.name,
        )
    return robot


def get_host(inventory: Inventory, name: str) -> Host:
    """The host of that name.

    Raises:
        HostError: it left the inventory.
    """
    host = inventory.hosts.get(name)
    if host is None:
        raise HostError(
            f"{name} is not in the inventory", hint="put it back until nothing runs there", host=name
        )
    return host
