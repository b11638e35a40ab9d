"""experiment run: every scheme on real hosts, as often as the spec says, one trial after the other on a fleet that is idle."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from edgectl.errors import EdgectlError, FleetBusyError, UsageError
from edgectl.evidence.recorder import Recorder
from edgectl.executor.manual import running
from edgectl.formats.digest import experiment_digest
from edgectl.gateway import collect
from edgectl.gateway.collect import ProbeOptions
from edgectl.model.course import Course, Watcher, unwatched
from edgectl.model.cycle import Cycle
from edgectl.model.evidence import Variant
from edgectl.model.experiment import Experiment, Machine, Run, Trial
from edgectl.model.snapshot import Snapshot
from edgectl.state.lock import FleetLock
from edgectl.state.memory import load_memory
from edgectl.state.runs import read_run, resumed, save_run, save_trial
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.trial import TrialOptions, clear, refuse_silence, trial

# A host's load is looked at for this long, and again where it is too high: right after a trial something may still be settling.
_WINDOW_S, _TIMEOUT_S, _PAUSE_S = 1.0, 30.0, 1.0
_FIRST_LOOKS, _LATER_LOOKS = 3, 30


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentOptions:
    """``directory``: where the run is kept. ``beside``: the directory of the spec. ``lock_timeout``: s to wait for another edgectl.

    ``watcher`` is told how far it is. ``control`` ends it early. ``debug``: a bug ends it.
    """

    directory: Path
    beside: Path
    lock_timeout: float = 0.0
    watcher: Watcher = unwatched
    control: Control = field(default_factory=Control)
    debug: bool = False


def experiment(fleet: Fleet, spec: Experiment, options: ExperimentOptions) -> Run:
    """Run the trials that are missing; the run with all that there are. It is not whole where ``control`` ended it.

    Raises:
        UsageError: the directory holds a run of other files.
        FleetBusyError: the fleet is not free: tasks run, a host's CPU is in use, or a host does not answer.
        LockBusyError: another edgectl is changing this fleet.
    """
    digest = experiment_digest(spec, fleet.inventory, fleet.tasks)
    known = _known(options.directory, digest, fleet)
    with FleetLock(fleet.state, verb="experiment", timeout=options.lock_timeout, clock=fleet.clock):
        clear(fleet)
        missing = _missing(spec, known)
        snapshot = _idle(fleet, spec, options.control, _FIRST_LOOKS) if missing else None
        machines = _machines(snapshot) if snapshot else known.machines if known else {}
        save_run(options.directory, Run(experiment=spec, digest=digest, machines=machines))
        if snapshot:
            _say_cordons(fleet)
            _trials(fleet, spec, missing, snapshot, options)
    return read_run(options.directory)


def _known(directory: Path, digest: str, fleet: Fleet) -> Run | None:
    known = resumed(directory, fleet.warn)
    if known is not None and known.digest != digest:
        message = f"{directory} holds a run of another fleet, other tasks or another mission: the files have changed since it began"
        raise UsageError(message, hint="give another directory: --out DIR")
    return known


def _missing(spec: Experiment, known: Run | None) -> list[tuple[Variant, int]]:
    """Scheme and repetition of every trial that is to be run: each repetition of all schemes in turn, so that drift hits all alike."""
    done = {(trial.scheme, trial.repetition) for trial in known.trials} if known else set()
    every = [(variant, repetition) for repetition in range(1, spec.repetitions + 1) for variant in spec.variants]
    return [(variant, repetition) for variant, repetition in every if (variant.name, repetition) not in done]


def _say_cordons(fleet: Fleet) -> None:
    cordons = load_memory(fleet.state, fleet.warn).cordons
    if cordons:
        fleet.warn(f"{', '.join(sorted(cordons))} cordoned: no trial starts a task there")


def _machines(snapshot: Snapshot) -> dict[str, Machine]:
    return {
        name: Machine(role=host.role, cores=host.cpu.cores, memory=host.memory.total_bytes)
        for name, host in snapshot.hosts.items()
        if host.cpu is not None and host.memory is not None
    }


def _idle(fleet: Fleet, spec: Experiment, control: Control, looks: int) -> Snapshot:
    """The fleet as it is before a trial.

    Raises:
        FleetBusyError: it is not free, and does not become so.
    """
    probing = ProbeOptions(window=_WINDOW_S, timeout=_TIMEOUT_S)
    while True:
        looks -= 1
        snapshot = collect.probe(fleet.inventory, fleet.tasks, fleet.transport, options=probing, clock=fleet.clock)
        refuse_silence(snapshot)
        _refuse_tasks(snapshot)
        busy = _loaded(snapshot, spec.idle)
        if not busy or control.stop_requested.is_set():
            return snapshot
        if looks <= 0:
            raise FleetBusyError(f"the fleet is busy: {busy}", hint="wait until it is idle, or raise idle: in the spec")
        control.wait(_PAUSE_S)


def _refuse_tasks(snapshot: Snapshot) -> None:
    for task, places in running(snapshot).items():
        raise FleetBusyError(f"{task} runs on {', '.join(places)}: an experiment needs the fleet for itself", hint="edgectl stop --all")


def _loaded(snapshot: Snapshot, idle: float) -> str:
    """Which hosts use more of their CPU than they may."""
    shares = {name: host.cpu.used_cores / host.cpu.cores for name, host in snapshot.hosts.items() if host.cpu is not None}
    found = [f"{name} uses {share:.0%} of its CPU" for name, share in shares.items() if share > idle]
    return f"{', '.join(found)}, and may use {idle:.0%}" if found else ""


def _trials(fleet: Fleet, spec: Experiment, missing: list[tuple[Variant, int]], snapshot: Snapshot, options: ExperimentOptions) -> None:
    total = len(spec.variants) * spec.repetitions
    began = fleet.uptime().seconds
    for position, (variant, repetition) in enumerate(missing):
        if position:
            snapshot = _idle(fleet, spec, options.control, _LATER_LOOKS)
        if options.control.stop_requested.is_set():
            return
        spent = fleet.uptime().seconds - began
        course = Course(
            scheme=variant.name,
            repetition=repetition,
            number=total - len(missing) + position + 1,
            total=total,
            until=spec.until,
            left=spent / position * (len(missing) - position) if position else None,
        )
        options.watcher(course)
        found = _tried(fleet, spec, variant, snapshot, course, options)
        if found is None:
            return
        options.watcher(replace(course, elapsed=found.latency, completed=tuple(found.completed), left=None, trial=found))


def _tried(
    fleet: Fleet, spec: Experiment, variant: Variant, snapshot: Snapshot, course: Course, options: ExperimentOptions
) -> Trial | None:
    """Run a trial, keep it, and clear the fleet; what is kept is kept, even where the fleet cannot be cleared."""
    given = TrialOptions(beside=options.beside, seen=_seen(fleet, course, options.watcher), control=options.control, debug=options.debug)
    try:
        found = trial(fleet, spec, variant, course.repetition, snapshot, given)
        if found is not None:
            save_trial(options.directory, found)
    except Exception:
        with suppress(EdgectlError):
            clear(fleet)
        raise
    clear(fleet)
    return found


def _seen(fleet: Fleet, course: Course, watcher: Watcher) -> Callable[[Recorder, Cycle], None]:
    began = fleet.uptime().seconds

    def seen(recorder: Recorder, cycle: Cycle) -> None:
        elapsed = fleet.uptime().seconds - began
        left = None if course.left is None else max(0.0, course.left - elapsed)
        completed = tuple(task for task in course.until if task in recorder.completed)
        watcher(replace(course, elapsed=elapsed, completed=completed, left=left, cycle=cycle))

    return seen
