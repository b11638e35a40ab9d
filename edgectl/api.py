"""The Python interface: a fleet is loaded, measured, planned, applied and watched as by the command line.

What ``__all__`` names is stable (docs/api.md). Every error that is raised on purpose is an ``EdgectlError``.
The values are those of ``edgectl.model``: frozen, in cores, bytes, bytes/s and seconds.
"""

import contextlib
import dataclasses
import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

from edgectl.cli.project import choose_files
from edgectl.cli.user_files import list_task_paths, refuse_exposed_files, select_exposed
from edgectl.config.documents import load_snapshot
from edgectl.errors import EdgectlError, InputError, UsageError
from edgectl.model.cycle import Cycle
from edgectl.model.diagnosis import Finding, HostFacts, Severity
from edgectl.model.event import Event, EventKind
from edgectl.model.inventory import Host, Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName, Weights
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.names import check_known_names
from edgectl.transport.base import Session, Transport
from edgectl.transport.local import LocalTransport
from edgectl.usecases.plan_execution import ApplyOptions, ApplyResult

if TYPE_CHECKING:
    from edgectl.usecases.fleet import Fleet as FleetPorts

__all__ = [
    "WEIGHT_PRESETS",
    "Action",
    "ActionResult",
    "ApplyResult",
    "Cycle",
    "EdgectlError",
    "Event",
    "EventKind",
    "Finding",
    "Fleet",
    "Host",
    "HostFacts",
    "HostSample",
    "InputError",
    "Inventory",
    "LocalTransport",
    "Outcome",
    "Plan",
    "Policy",
    "PolicyName",
    "Results",
    "Session",
    "Severity",
    "Snapshot",
    "Step",
    "Task",
    "TaskSample",
    "Tasks",
    "Transport",
    "UsageError",
    "Weights",
    "load_snapshot",
]

_LOG = logging.getLogger("edgectl")


class Fleet:
    """A fleet of hosts and its tasks. Make one with ``Fleet.load``; use it from one thread."""

    def __init__(self, ports: "FleetPorts") -> None:
        self._ports = ports

    @classmethod
    def load(
        cls,
        inventory: str | Path | Sequence[str | Path] | None = None,
        tasks: str | Path | Sequence[str | Path] | None = None,
        *,
        accept_new: bool = False,
        transport: Transport | None = None,
        warn: Callable[[str], None] = _LOG.warning,
    ) -> Self:
        """Load the files; no host is contacted.

        ``inventory`` and ``tasks`` (files, or directories of files) are found as by the command line if they
        are None; no tasks: ``tasks=[]``. ``accept_new`` records the keys of unknown hosts. ``transport``
        replaces the connections, for tests. ``warn`` receives each warning; else the logger ``edgectl`` does.

        Raises:
            InputError: everything that is wrong with the files, or other users may write them.
            UsageError: a file is not given and cannot be chosen.
        """
        from edgectl.config.load import load_inventory_and_tasks
        from edgectl.state.fleet_dir import ensure_fleet_dir
        from edgectl.usecases.open_fleet import open_fleet

        chosen = choose_files(_list_paths(inventory), _list_paths(tasks))
        without_tasks = tasks is not None and not _list_paths(tasks)
        stated, work, problems = load_inventory_and_tasks(
            chosen.inventories, [] if without_tasks else list_task_paths(chosen)
        )
        exposed = select_exposed(problems)
        refuse_exposed_files(exposed)
        for problem in problems:
            if problem not in exposed:
                warn(f"{problem.file}:{problem.line}: {problem.message} ({problem.code})")
        state = ensure_fleet_dir(stated.fleet, chosen.inventories[0])
        ports = open_fleet(stated, work, state, warn=warn, accept_new=accept_new)
        return cls(ports if transport is None else dataclasses.replace(ports, transport=transport))

    @property
    def name(self) -> str:
        """The name of the fleet, which owns its tasks on the hosts."""
        return self._ports.inventory.fleet

    @property
    def inventory(self) -> Inventory:
        """Edges, robots and links, as loaded."""
        return self._ports.inventory

    @property
    def tasks(self) -> Tasks:
        """Tasks and policy, as loaded."""
        return self._ports.tasks

    @property
    def policy(self) -> Policy:
        """The policy of the task files; ``dataclasses.replace`` makes another one of it."""
        return self._ports.tasks.policy

    def probe(self, *, timeout: float = 15.0) -> Snapshot:
        """Measure every host, link and task. A host that does not answer within ``timeout`` seconds is
        ``unreachable`` in the snapshot, no error.
        """
        from edgectl.gateway.host_probe import ProbeOptions
        from edgectl.usecases.probe import probe_fleet

        return probe_fleet(self._ports, ProbeOptions(timeout=timeout))

    def plan(self, policy: Policy | None = None, *, snapshot: Snapshot | None = None) -> Plan:
        """Decide for every task, as ``edgectl plan``: from a fresh probe, or from ``snapshot`` (no host is
        contacted, and the same files give the same plan). Nothing is changed.

        Raises:
            UsageError: the policy cannot be used.
        """
        from edgectl.usecases.plan import is_what_if, make_plan

        how = self._check_policy(policy)
        return make_plan(self._ports, how, snapshot=snapshot, recorded=not is_what_if(self._ports, how))

    def apply(
        self,
        *,
        confirm: Callable[[Plan], bool],
        policy: Policy | None = None,
        attended: bool = False,
        lock_timeout: float | None = None,
    ) -> ApplyResult:
        """Probe, plan, ask ``confirm`` if the plan changes anything, and carry it out, as ``edgectl apply``.

        Not ``attended``: at most ``max_moves`` of the policy, after a second measurement, as from cron.
        ``lock_timeout`` (s): how long to wait for another edgectl. Failed actions are results, no errors.

        Raises:
            LockBusyError: another edgectl is changing this fleet.
            UsageError: the policy cannot be used.
        """
        from edgectl.usecases.apply import RECHECK_WINDOW_S, plan_and_apply

        how = dataclasses.replace(self._check_policy(policy), attended=attended)
        options = ApplyOptions(
            lock_timeout=lock_timeout, recheck_window=None if attended else RECHECK_WINDOW_S
        )
        return plan_and_apply(self._ports, how, confirm, options)

    def watch(
        self,
        *,
        every: float = 10.0,
        apply: bool = False,
        cycles: int | None = None,
        policy: Policy | None = None,
    ) -> Iterator[Cycle]:
        """Yield one `Cycle` every ``every`` seconds, as ``edgectl watch``; ``apply`` carries its plans out.

        An error belongs to its cycle (``Cycle.error``), and the next one is tried. The iterator holds
        connections: read it to its end (``cycles``), or close it (``contextlib.closing``).

        Raises:
            LockBusyError: another watch applies plans to this fleet.
            UsageError: the policy cannot be used, or ``every`` is below 1 s.
        """
        if every < 1:
            raise UsageError(f"a watch every {every:g} s is too often", hint="pass every=1.0 or more")
        how = self._check_policy(policy)
        return self._yield_cycles(how, every=every, apply=apply, cycles=cycles)

    def _yield_cycles(
        self, policy: Policy, *, every: float, apply: bool, cycles: int | None
    ) -> Generator[Cycle, None, None]:
        from edgectl.usecases.watch import WatchOptions, watch_fleet

        options = WatchOptions(every=every, apply=apply, cycles=cycles, policy=lambda _: policy)
        with contextlib.closing(watch_fleet(self._ports, options)) as found:
            yield from found

    def _check_policy(self, policy: Policy | None) -> Policy:
        """``policy``, or that of the files."""
        from edgectl.usecases.plan import check_search

        if policy is None:
            return self.policy
        check_known_names(policy.without, self.inventory.hosts, "host")
        check_search(policy)
        try:
            policy.weights.normalised()
        except ValueError as error:
            raise UsageError(str(error), hint="pass weights of 0 or more, not all 0") from None
        if policy.optimal:
            _require_solver()
        return policy


def _require_solver() -> None:
    try:
        import edgectl.solver.highs  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"a best plan needs {error.name}", hint="install edgectl with the extra opt"
        ) from None


def _list_paths(given: str | Path | Sequence[str | Path] | None) -> list[Path] | None:
    if given is None:
        return None
    return [Path(each) for each in ([given] if isinstance(given, str | Path) else given)]
