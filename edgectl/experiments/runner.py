# SPDX-License-Identifier: Apache-2.0
"""Run an experiment on real hosts: all missing trials, one after the other, each on an idle fleet."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from edgectl.errors import EdgectlError, FleetBusyError, UsageError
from edgectl.executor.operator_plans import list_running_instances
from edgectl.experiments.event_actions import Ask, ask_nobody
from edgectl.experiments.files.run_codec import digest_experiment
from edgectl.experiments.files.run_directory import (
    create_run_directory,
    load_run,
    load_run_to_resume,
    save_run,
    save_trial,
)
from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HostCapacity,
    Trial,
    TrialListener,
    TrialProgress,
    ignore_trial_progress,
)
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.trial import TrialOptions, check_all_hosts_answered, clean_up_trials, run_trial
from edgectl.experiments.trial_recorder import TrialRecorder
from edgectl.gateway import host_probe
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.cycle import Cycle
from edgectl.model.resource import CPU, MEMORY
from edgectl.model.snapshot import Snapshot
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import load_manager_state
from edgectl.usecases.control import Control
from edgectl.usecases.coordination import hold_in_etcd
from edgectl.usecases.fleet import Fleet

# Load is measured over this window, and again if it is too high: processes may still be ending after a trial.
_IDLE_WINDOW_S, _IDLE_PROBE_TIMEOUT_S, _IDLE_PAUSE_S = 1.0, 30.0, 1.0
_FIRST_IDLE_CHECKS, _LATER_IDLE_CHECKS = 3, 30


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentOptions:
    """``directory``: of the run.

    ``spec_directory``: of the experiment file. ``lock_timeout``: s to wait for the lock; None: for one cycle
    of a watch.

    ``listener`` receives progress. ``control`` ends the run early. ``debug``: a bug raises instead of failing
    its cycle. ``ask``: puts the requests of events to a person.
    """

    directory: Path
    spec_directory: Path
    lock_timeout: float | None = None
    listener: TrialListener = ignore_trial_progress
    control: Control = field(default_factory=Control)
    debug: bool = False
    ask: Ask = ask_nobody


def run_experiment(fleet: Fleet, experiment: Experiment, options: ExperimentOptions) -> ExperimentRun:
    """Run the missing trials; returns the run with all trials so far, incomplete if ``control`` ended it.

    Raises:
        UsageError: the directory holds a run of other files.
        FleetBusyError: the fleet is not idle: tasks run, a host's CPU is in use, or a host does not answer.
        LockBusyError: another edgectl is changing this fleet, or writes into the directory.
        CoordinationError: the etcd of the fleet does not answer.
    """
    digest = digest_experiment(experiment, fleet.inventory, fleet.tasks)
    _load_matching_run(options.directory, digest, fleet)
    with (
        _hold_lock(fleet.state, fleet, options),
        hold_in_etcd(fleet, "experiment", patience_s=options.lock_timeout),
    ):
        # Trials have a state of their own, which no other machine takes over.
        fleet = replace(fleet, inventory=replace(fleet.inventory, coordination=None))
        clean_up_trials(fleet)
        known = _load_matching_run(options.directory, digest, fleet)
        missing = _order_missing_trials(experiment, known)
        snapshot = (
            _wait_until_idle(fleet, experiment, options.control, _FIRST_IDLE_CHECKS) if missing else None
        )
        machines = _capacities_from_snapshot(snapshot) if snapshot else known.machines if known else {}
        header = ExperimentRun(experiment=experiment, digest=digest, machines=machines)
        create_run_directory(options.directory)
        # An experiment of another fleet would write its trials among these.
        with _hold_lock(options.directory, fleet, options):
            missing = _order_missing_trials(experiment, _load_matching_run(options.directory, digest, fleet))
            save_run(options.directory, header)
            if snapshot:
                _warn_about_cordons(fleet)
                _run_missing_trials(fleet, experiment, missing, snapshot, options)
    return load_run(options.directory)


def _hold_lock(directory: Path, fleet: Fleet, options: ExperimentOptions) -> FleetLock:
    return FleetLock(directory, verb="experiment", timeout=options.lock_timeout, clock=fleet.clock)


def _load_matching_run(directory: Path, digest: str, fleet: Fleet) -> ExperimentRun | None:
    known = load_run_to_resume(directory, fleet.warn)
    if known is not None and known.digest != digest:
        raise UsageError(
            f"{directory} holds a run of another experiment: "
            "fleet, tasks or mission have changed since it began",
            hint="choose another directory: --out DIR",
        )
    return known


def _order_missing_trials(experiment: Experiment, known: ExperimentRun | None) -> list[tuple[Scheme, int]]:
    """Scheme and repetition of each missing trial.

    Repetitions are interleaved over schemes, so that drift affects all alike.
    """
    done = {(trial.scheme, trial.repetition) for trial in known.trials} if known else set()
    return [
        (scheme, repetition)
        for repetition in range(1, experiment.repetitions + 1)
        for scheme in experiment.schemes
        if (scheme.name, repetition) not in done
    ]


def _warn_about_cordons(fleet: Fleet) -> None:
    cordons = load_manager_state(fleet.state, fleet.warn).cordons
    if cordons:
        fleet.warn(f"cordoned: {', '.join(sorted(cordons))}; trials start no tasks there")


def _capacities_from_snapshot(snapshot: Snapshot) -> dict[str, HostCapacity]:
    return {
        name: HostCapacity(
            role=host.role, cores=host.usage[CPU.name].capacity, memory=host.usage[MEMORY.name].capacity
        )
        for name, host in snapshot.hosts.items()
        if host.measured
    }


def _wait_until_idle(fleet: Fleet, experiment: Experiment, control: Control, attempts: int) -> Snapshot:
    """Probe up to ``attempts`` times until all hosts are idle; returns the last snapshot.

    Raises:
        FleetBusyError: a task runs, a host does not answer, or hosts are still busy after the last attempt.
    """
    probe_options = ProbeOptions(window=_IDLE_WINDOW_S, timeout=_IDLE_PROBE_TIMEOUT_S)
    while True:
        attempts -= 1
        snapshot = host_probe.probe_hosts(
            fleet.inventory, fleet.tasks, fleet.transport, options=probe_options, clock=fleet.clock
        )
        check_all_hosts_answered(snapshot)
        _check_no_task_runs(snapshot)
        busy = _describe_busy_hosts(snapshot, experiment.idle)
        if not busy or control.stop_requested.is_set():
            return snapshot
        if attempts <= 0:
            raise FleetBusyError(
                f"the fleet is busy: {busy}",
                hint="wait until it is idle, or raise idle: in the experiment file",
            )
        control.wait(_IDLE_PAUSE_S)


def _check_no_task_runs(snapshot: Snapshot) -> None:
    for task, hosts in list_running_instances(snapshot).items():
        raise FleetBusyError(
            f"{task} runs on {', '.join(hosts)}: an experiment needs an idle fleet",
            hint="edgectl stop --all",
        )
    for name, host in snapshot.hosts.items():
        for other in (*host.other_tasks, *host.foreign_tasks):
            owner = f"of fleet {other.fleet}" if other.fleet else f"filed under {other.host}"
            raise FleetBusyError(
                f"{other.task} {owner} runs on {name}: an experiment needs an idle fleet",
                hint="stop it with its own inventory",
            )


def _describe_busy_hosts(snapshot: Snapshot, idle: float) -> str:
    """Hosts whose CPU utilisation (0..1) exceeds ``idle``; "" if none."""
    shares = {
        name: host.usage[CPU.name].share for name, host in snapshot.hosts.items() if CPU.name in host.usage
    }
    busy = [f"{name} uses {share:.0%} of its CPU" for name, share in shares.items() if share > idle]
    return f"{', '.join(busy)} (limit {idle:.0%})" if busy else ""


def _run_missing_trials(
    fleet: Fleet,
    experiment: Experiment,
    missing: list[tuple[Scheme, int]],
    snapshot: Snapshot,
    options: ExperimentOptions,
) -> None:
    total = len(experiment.schemes) * experiment.repetitions
    began = fleet.uptime().seconds
    for position, (scheme, repetition) in enumerate(missing):
        if position:
            snapshot = _wait_until_idle(fleet, experiment, options.control, _LATER_IDLE_CHECKS)
        if options.control.stop_requested.is_set():
            return
        spent = fleet.uptime().seconds - began
        progress = TrialProgress(
            scheme=scheme.name,
            repetition=repetition,
            number=total - len(missing) + position + 1,
            total=total,
            until=experiment.until,
            left=spent / position * (len(missing) - position) if position else None,
        )
        options.listener(progress)
        trial = _run_and_save_trial(fleet, experiment, scheme, snapshot, progress, options)
        if trial is None:
            return
        options.listener(
            replace(progress, elapsed=trial.latency, completed=tuple(trial.completed), left=None, trial=trial)
        )


def _run_and_save_trial(
    fleet: Fleet,
    experiment: Experiment,
    scheme: Scheme,
    snapshot: Snapshot,
    progress: TrialProgress,
    options: ExperimentOptions,
) -> Trial | None:
    """Run and save a trial, then clear the fleet. The trial is saved even if the fleet cannot be cleared."""
    trial_options = TrialOptions(
        spec_directory=options.spec_directory,
        listener=_build_cycle_listener(fleet, progress, options.listener),
        control=options.control,
        debug=options.debug,
        ask=options.ask,
    )
    try:
        trial = run_trial(fleet, experiment, scheme, progress.repetition, snapshot, trial_options)
        if trial is not None:
            save_trial(options.directory, trial)
    except Exception:
        with suppress(EdgectlError):
            clean_up_trials(fleet)
        raise
    clean_up_trials(fleet)
    return trial


def _build_cycle_listener(
    fleet: Fleet, progress: TrialProgress, listener: TrialListener
) -> Callable[[TrialRecorder, Cycle], None]:
    began = fleet.uptime().seconds

    def report_cycle(recorder: TrialRecorder, cycle: Cycle) -> None:
        elapsed = fleet.uptime().seconds - began
        left = None if progress.left is None else max(0.0, progress.left - elapsed)
        completed = tuple(task for task in progress.until if task in recorder.completed)
        listener(replace(progress, elapsed=elapsed, completed=completed, left=left, cycle=cycle))

    return report_cycle
