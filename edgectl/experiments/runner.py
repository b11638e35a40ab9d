"""experiment run: every scheme on real hosts, as often as the spec says, one trial after the other on a fleet that is idle."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from edgectl.errors import EdgectlError, FleetBusyError, UsageError
from edgectl.executor.operator_plans import list_running_instances
from edgectl.experiments.files.run_directory import load_run, load_run_to_resume, save_run, save_trial
from edgectl.experiments.model.comparison import Scheme
from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HostCapacity,
    Trial,
    TrialListener,
    TrialProgress,
    ignore_trial_progress,
)
from edgectl.experiments.trial import TrialOptions, check_all_hosts_answered, clean_up_trials, run_trial
from edgectl.experiments.trial_recorder import TrialRecorder
from edgectl.formats.digest import digest_experiment
from edgectl.gateway import host_probe
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.cycle import Cycle
from edgectl.model.snapshot import Snapshot
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import load_manager_state
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet

# A host's load is looked at for this long, and again where it is too high: right after a trial something may still be settling.
_IDLE_WINDOW_S, _IDLE_PROBE_TIMEOUT_S, _IDLE_PAUSE_S = 1.0, 30.0, 1.0
_FIRST_IDLE_CHECKS, _LATER_IDLE_CHECKS = 3, 30


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentOptions:
    """``directory``: where the run is kept. ``beside``: the directory of the spec. ``lock_timeout``: s to wait for another edgectl.

    ``watcher`` is told how far it is. ``control`` ends it early. ``debug``: a bug ends it.
    """

    directory: Path
    beside: Path
    lock_timeout: float = 0.0
    watcher: TrialListener = ignore_trial_progress
    control: Control = field(default_factory=Control)
    debug: bool = False


def run_experiment(fleet: Fleet, spec: Experiment, options: ExperimentOptions) -> ExperimentRun:
    """Run the trials that are missing; the run with all that there are. It is not whole where ``control`` ended it.

    Raises:
        UsageError: the directory holds a run of other files.
        FleetBusyError: the fleet is not free: tasks run, a host's CPU is in use, or a host does not answer.
        LockBusyError: another edgectl is changing this fleet.
    """
    digest = digest_experiment(spec, fleet.inventory, fleet.tasks)
    known = _load_matching_run(options.directory, digest, fleet)
    with FleetLock(fleet.state, verb="experiment", timeout=options.lock_timeout, clock=fleet.clock):
        clean_up_trials(fleet)
        missing = _order_missing_trials(spec, known)
        snapshot = _wait_until_idle(fleet, spec, options.control, _FIRST_IDLE_CHECKS) if missing else None
        machines = _capacities_from_snapshot(snapshot) if snapshot else known.machines if known else {}
        save_run(options.directory, ExperimentRun(experiment=spec, digest=digest, machines=machines))
        if snapshot:
            _warn_about_cordons(fleet)
            _run_missing_trials(fleet, spec, missing, snapshot, options)
    return load_run(options.directory)


def _load_matching_run(directory: Path, digest: str, fleet: Fleet) -> ExperimentRun | None:
    known = load_run_to_resume(directory, fleet.warn)
    if known is not None and known.digest != digest:
        message = f"{directory} holds a run of another fleet, other tasks or another mission: the files have changed since it began"
        raise UsageError(message, hint="give another directory: --out DIR")
    return known


def _order_missing_trials(spec: Experiment, known: ExperimentRun | None) -> list[tuple[Scheme, int]]:
    """Scheme and repetition of every trial that is to be run: each repetition of all schemes in turn, so that drift hits all alike."""
    done = {(trial.scheme, trial.repetition) for trial in known.trials} if known else set()
    every = [
        (variant, repetition) for repetition in range(1, spec.repetitions + 1) for variant in spec.schemes
    ]
    return [(variant, repetition) for variant, repetition in every if (variant.name, repetition) not in done]


def _warn_about_cordons(fleet: Fleet) -> None:
    cordons = load_manager_state(fleet.state, fleet.warn).cordons
    if cordons:
        fleet.warn(f"{', '.join(sorted(cordons))} cordoned: no trial starts a task there")


def _capacities_from_snapshot(snapshot: Snapshot) -> dict[str, HostCapacity]:
    return {
        name: HostCapacity(role=host.role, cores=host.cpu.cores, memory=host.memory.total_bytes)
        for name, host in snapshot.hosts.items()
        if host.cpu is not None and host.memory is not None
    }


def _wait_until_idle(fleet: Fleet, spec: Experiment, control: Control, looks: int) -> Snapshot:
    """The fleet as it is before a trial.

    Raises:
        FleetBusyError: it is not free, and does not become so.
    """
    probing = ProbeOptions(window=_IDLE_WINDOW_S, timeout=_IDLE_PROBE_TIMEOUT_S)
    while True:
        looks -= 1
        snapshot = host_probe.probe_hosts(
            fleet.inventory, fleet.tasks, fleet.transport, options=probing, clock=fleet.clock
        )
        check_all_hosts_answered(snapshot)
        _check_no_task_runs(snapshot)
        busy = _describe_busy_hosts(snapshot, spec.idle)
        if not busy or control.stop_requested.is_set():
            return snapshot
        if looks <= 0:
            raise FleetBusyError(
                f"the fleet is busy: {busy}", hint="wait until it is idle, or raise idle: in the spec"
            )
        control.wait(_IDLE_PAUSE_S)


def _check_no_task_runs(snapshot: Snapshot) -> None:
    for task, places in list_running_instances(snapshot).items():
        raise FleetBusyError(
            f"{task} runs on {', '.join(places)}: an experiment needs the fleet for itself",
            hint="edgectl stop --all",
        )


def _describe_busy_hosts(snapshot: Snapshot, idle: float) -> str:
    """Which hosts use more of their CPU than they may."""
    shares = {
        name: host.cpu.used_cores / host.cpu.cores
        for name, host in snapshot.hosts.items()
        if host.cpu is not None
    }
    found = [f"{name} uses {share:.0%} of its CPU" for name, share in shares.items() if share > idle]
    return f"{', '.join(found)}, and may use {idle:.0%}" if found else ""


def _run_missing_trials(
    fleet: Fleet,
    spec: Experiment,
    missing: list[tuple[Scheme, int]],
    snapshot: Snapshot,
    options: ExperimentOptions,
) -> None:
    total = len(spec.schemes) * spec.repetitions
    began = fleet.uptime().seconds
    for position, (variant, repetition) in enumerate(missing):
        if position:
            snapshot = _wait_until_idle(fleet, spec, options.control, _LATER_IDLE_CHECKS)
        if options.control.stop_requested.is_set():
            return
        spent = fleet.uptime().seconds - began
        course = TrialProgress(
            scheme=variant.name,
            repetition=repetition,
            number=total - len(missing) + position + 1,
            total=total,
            until=spec.until,
            left=spent / position * (len(missing) - position) if position else None,
        )
        options.watcher(course)
        found = _run_and_save_trial(fleet, spec, variant, snapshot, course, options)
        if found is None:
            return
        options.watcher(
            replace(course, elapsed=found.latency, completed=tuple(found.completed), left=None, trial=found)
        )


def _run_and_save_trial(
    fleet: Fleet,
    spec: Experiment,
    variant: Scheme,
    snapshot: Snapshot,
    course: TrialProgress,
    options: ExperimentOptions,
) -> Trial | None:
    """Run a trial, keep it, and clear the fleet; what is kept is kept, even where the fleet cannot be cleared."""
    given = TrialOptions(
        beside=options.beside,
        seen=_build_cycle_listener(fleet, course, options.watcher),
        control=options.control,
        debug=options.debug,
    )
    try:
        found = run_trial(fleet, spec, variant, course.repetition, snapshot, given)
        if found is not None:
            save_trial(options.directory, found)
    except Exception:
        with suppress(EdgectlError):
            clean_up_trials(fleet)
        raise
    clean_up_trials(fleet)
    return found


def _build_cycle_listener(
    fleet: Fleet, course: TrialProgress, watcher: TrialListener
) -> Callable[[TrialRecorder, Cycle], None]:
    began = fleet.uptime().seconds

    def seen(recorder: TrialRecorder, cycle: Cycle) -> None:
        elapsed = fleet.uptime().seconds - began
        left = None if course.left is None else max(0.0, course.left - elapsed)
        completed = tuple(task for task in course.until if task in recorder.completed)
        watcher(replace(course, elapsed=elapsed, completed=completed, left=left, cycle=cycle))

    return seen
