"""One trial of an experiment: a manager without a past deploys, watches until the mission is over, and leaves nothing behind."""

import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from edgectl.errors import EdgectlError, FleetBusyError
from edgectl.executor.operator_plans import build_stop_plan, list_running_instances
from edgectl.experiments.model.comparison import Scheme
from edgectl.experiments.model.experiment import Experiment, MapPair, Trial
from edgectl.experiments.trial_recorder import TrialRecorder
from edgectl.gateway.fetch import fetch_file
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.cycle import Cycle
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot, TaskState
from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.json_files import STATE_FORMAT_VERSION, read_json, write_json
from edgectl.state.manager_state import (
    fingerprint_state_files,
    load_ignored_instances,
    load_link_capacities,
    load_manager_state,
    save_ignored_instances,
    save_link_capacities,
    save_manager_state,
)
from edgectl.state.paths import ensure_private_dir
from edgectl.state.store_handle import StoreHandle
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan_execution import ApplyOptions, confirm_always, confirm_and_execute, lock_fleet
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.watch import WatchOptions, watch_fleet

# A window in which use is measured is never most of a cycle; a host that hangs does not hold one up for long.
_TRIAL_PROBE_WINDOW_S, _TRIAL_PROBE_TIMEOUT_S = 0.5, 10.0
_CHECK_WINDOW_S, _CHECK_TIMEOUT_S = 0.1, 30.0
_FETCH_TIMEOUT_S = 60.0
_STOP_ATTEMPTS = 3
_STATE_DIR_PREFIX, _FINGERPRINT_FILE_NAME = "trial-", "before.json"
CycleListener = Callable[[TrialRecorder, Cycle], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialOptions:
    """``beside``: where the truth of maps is looked for. ``seen`` hears of every cycle. ``control`` ends the trial early.

    ``debug``: a bug ends the trial, instead of its cycle alone.
    """

    beside: Path
    seen: CycleListener
    control: Control
    debug: bool = False


def run_trial(
    fleet: Fleet,
    experiment: Experiment,
    variant: Scheme,
    repetition: int,
    before: Snapshot,
    options: TrialOptions,
) -> Trial | None:
    """Run one trial on a fleet that is idle, as ``before`` shows it; None where ``control`` ended it. Tasks may be left: `clear` follows.

    Call it with the fleet's lock held.
    """
    own = _prepare_trial_fleet(
        fleet, f"{_STATE_DIR_PREFIX}{variant.name.replace(' ', '-')}-{repetition}", before
    )
    recorder = TrialRecorder(experiment.until)
    given = WatchOptions(
        every=experiment.every,
        apply=True,
        debug=options.debug,
        probe=ProbeOptions(
            window=min(_TRIAL_PROBE_WINDOW_S, experiment.every / 2), timeout=_TRIAL_PROBE_TIMEOUT_S
        ),
        policy=lambda _: variant.policy,
        progress=lambda event: recorder.record_progress(event, own.clock()),
        control=options.control,
    )
    began = own.clock()
    with closing(watch_fleet(own, given)) as cycles:  # type: ignore[type-var]
        for cycle in cycles:
            recorder.record_cycle(cycle)
            options.seen(recorder, cycle)
            if (
                recorder.finished
                or recorder.has_given_up
                or own.clock() - (recorder.began or began) >= experiment.limit
            ):
                break
        else:
            return None
    ended = own.clock()
    ssim = _score_maps(own, experiment, recorder.places, options.beside)
    return recorder.build_trial(variant.name, repetition, limit=experiment.limit, ended=ended, ssim=ssim)


def _prepare_trial_fleet(fleet: Fleet, name: str, before: Snapshot) -> Fleet:
    """The fleet for a manager that remembers nothing but what an operator said of the hosts and what was measured of the links.

    What ended on a host earlier counts no longer. The clock is one that nobody sets.
    """
    state = ensure_private_dir(fleet.state / name)
    began, since = fleet.clock(), fleet.uptime().seconds
    said = load_manager_state(fleet.state, fleet.warn)
    write_json(state / _FINGERPRINT_FILE_NAME, _encode_state_fingerprint(fleet), keep=False)
    save_manager_state(state, ManagerState(cordons=said.cordons, draining=said.draining))
    save_link_capacities(state, load_link_capacities(fleet.state, fleet.warn))
    save_ignored_instances(
        state,
        tuple(
            dict.fromkeys(
                (*load_ignored_instances(fleet.state, fleet.warn), *_collect_ended_instances(before))
            )
        ),
    )
    _transfer_holds(fleet, fleet.state, state, released=False)
    return replace(
        fleet, state=state, history=StoreHandle(), clock=lambda: began + fleet.uptime().seconds - since
    )


def _collect_ended_instances(snapshot: Snapshot) -> dict[str, tuple[str, int]]:
    """Task and generation of the instances that have ended and would not be started again."""
    return {
        sample.instance: (task, sample.generation)
        for host in snapshot.hosts.values()
        for task, sample in host.tasks.items()
        if sample.state is TaskState.COMPLETED or sample.given_up
    }


def _encode_state_fingerprint(fleet: Fleet) -> dict[str, object]:
    """How the fleet's own files stand: no other edgectl changes the fleet without changing them."""
    return {
        "format_version": STATE_FORMAT_VERSION,
        "stamp": [each and list(each) for each in fingerprint_state_files(fleet.state)],
    }


def clean_up_trials(fleet: Fleet) -> None:
    """Stop what trials left running, with proof, and forget them. Call it with the fleet's lock held.

    What another edgectl has taken over since is not touched.

    Raises:
        FleetBusyError: a task does not stop, or a host that may run one does not answer.
    """
    for state in sorted(fleet.state.glob(f"{_STATE_DIR_PREFIX}*")):
        own = replace(fleet, state=ensure_private_dir(state), history=StoreHandle())
        known, untouched = _load_started_generations(own), _is_fleet_state_unchanged(fleet, state)
        snapshot = _stop_trial_tasks(own, known) if untouched else _probe_all_hosts(own)
        ended = sorted(
            instance
            for instance, (task, generation) in _collect_ended_instances(snapshot).items()
            if generation <= known.get(task, -1)
        )
        save_ignored_instances(fleet.state, (*load_ignored_instances(fleet.state, fleet.warn), *ended))
        _transfer_holds(fleet, state, fleet.state, released=untouched)
        shutil.rmtree(state)


def _transfer_holds(fleet: Fleet, source: Path, target: Path, *, released: bool) -> None:
    """A robot that was told to hold is let go by whoever steers it next, so its hold outlives the journal that knows of it."""
    held, known = (
        set(read_journal_cached(source / JOURNAL_FILE_NAME).held),
        set(read_journal_cached(target / JOURNAL_FILE_NAME).held),
    )
    told = [
        *(("phase", task) for task in held - known),
        *(("released", task) for task in known - held if released),
    ]
    if told:
        with Journal.open(target, clock=fleet.clock, warn=fleet.warn) as journal:
            for event, task in sorted(told):
                journal.append(event, task=task, **({"phase": "hold"} if event == "phase" else {}))


def _is_fleet_state_unchanged(fleet: Fleet, state: Path) -> bool:
    try:
        return read_json(state / _FINGERPRINT_FILE_NAME) in (None, _encode_state_fingerprint(fleet))
    except ValueError:
        return False


def _stop_trial_tasks(own: Fleet, known: Mapping[str, int]) -> Snapshot:
    """The fleet without the tasks that this trial started; a later start, by whomever, has a higher generation and is left alone."""
    names: list[str] = []
    for _ in range(_STOP_ATTEMPTS):
        snapshot = _probe_all_hosts(own)
        places = list_running_instances(snapshot)
        names = [
            name
            for name in places
            if all(
                snapshot.hosts[host].tasks[name].generation <= known.get(name, -1) for host in places[name]
            )
        ]
        if not names:
            return snapshot
        with lock_fleet(own, "stop", ApplyOptions()) as held:
            confirm_and_execute(
                held,
                build_stop_plan(names, own.inventory, own.tasks, snapshot),
                confirm_always,
                ApplyOptions(),
                verb="stop",
            )
    raise FleetBusyError(f"{', '.join(names)} did not stop", hint=f"edgectl stop {names[0]} says why")


def _probe_all_hosts(own: Fleet) -> Snapshot:
    """What runs where; every host has to say."""
    snapshot = probe_fleet(own, ProbeOptions(window=_CHECK_WINDOW_S, timeout=_CHECK_TIMEOUT_S))
    check_all_hosts_answered(snapshot)
    return snapshot


def check_all_hosts_answered(snapshot: Snapshot) -> None:
    """See that every host answered.

    Raises:
        FleetBusyError: one did not.
    """
    for name, host in snapshot.hosts.items():
        if not host.ok:
            raise FleetBusyError(
                f"{name} does not answer: {host.error}", hint=host.hint or f"edgectl doctor {name}"
            )


def _load_started_generations(own: Fleet) -> dict[str, int]:
    """By task, the highest generation that this trial may have started."""
    with Journal.open(own.state, clock=own.clock, warn=own.warn) as journal:
        known = dict(journal.log.generations)
    for name, placement in load_manager_state(own.state, own.warn).placements.items():
        known[name] = max(known.get(name, 0), placement.generation)
    return known


def _score_maps(
    own: Fleet, experiment: Experiment, places: Mapping[str, str], beside: Path
) -> dict[str, float]:
    """The maps that the tasks left against their truths. One that cannot be had is said, and has no value."""
    found = {}
    for column, pair in experiment.maps.items():
        if pair.task not in places:
            own.warn(f"{column}: {pair.task} never ran, so there is no map")
            continue
        try:
            found[column] = _score_map(own, pair, places[pair.task], beside)
        except EdgectlError as error:
            own.warn(f"{column}: no map of {pair.task} from {places[pair.task]}: {error.message}")
    return found


def _score_map(own: Fleet, pair: MapPair, place: str, beside: Path) -> float:
    from edgectl.experiments.map_comparison import compare_maps

    host, task = own.inventory.hosts[place], own.tasks.tasks[pair.task]
    return compare_maps(
        pair.file,
        lambda file: fetch_file(own.transport, host, task, file, timeout=_FETCH_TIMEOUT_S),
        beside / pair.truth,
    )
