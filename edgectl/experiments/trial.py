# SPDX-License-Identifier: Apache-2.0
"""A trial of an experiment: deploy a mission as a new manager, watch it, score its maps, clear the fleet."""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from edgectl.errors import EdgectlError, FleetBusyError
from edgectl.executor.operator_plans import build_stop_plan, list_running_instances
from edgectl.experiments.event_actions import Ask, EventMeans, ask_nobody
from edgectl.experiments.event_draws import build_uniform_draw
from edgectl.experiments.event_performer import EventPerformer
from edgectl.experiments.held_changes import undo_held_changes
from edgectl.experiments.model.experiment import Experiment, MapPair, Trial
from edgectl.experiments.model.mission_event import select_present_tasks
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.trial_recorder import TrialRecorder
from edgectl.experiments.trial_state import (
    collect_ended_instances,
    create_trial_fleet,
    delete_trial_state,
    is_fleet_state_unchanged,
    load_started_generations,
    reopen_trial_fleets,
)
from edgectl.gateway.fetch import fetch_file
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.cycle import Cycle
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan_execution import ApplyOptions, confirm_always, confirm_and_execute, lock_fleet
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.watch import WatchOptions, watch_fleet

# The window that measures usage stays below half a cycle, and a host that hangs delays a cycle by 10 s at
# most.
_TRIAL_PROBE_WINDOW_S, _TRIAL_PROBE_TIMEOUT_S = 0.5, 10.0
_CHECK_WINDOW_S, _CHECK_TIMEOUT_S = 0.1, 30.0
_FETCH_TIMEOUT_S = 60.0
_STOP_ATTEMPTS = 3
CycleListener = Callable[[TrialRecorder, Cycle], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialOptions:
    """``spec_directory``: the base of the paths of ground truth maps.

    ``listener`` is called after each cycle.

    ``control`` ends the trial early. ``debug``: a bug raises instead of failing its cycle. ``ask``: puts the
    requests of events to a person.
    """

    spec_directory: Path
    listener: CycleListener
    control: Control
    debug: bool = False
    ask: Ask = ask_nobody


def run_trial(
    fleet: Fleet,
    experiment: Experiment,
    scheme: Scheme,
    repetition: int,
    before: Snapshot,
    options: TrialOptions,
) -> Trial | None:
    """Run one trial on an idle fleet, whose snapshot is ``before``; None if ``control`` ended it.

    The caller holds the fleet's lock, and calls `clean_up_trials` afterwards: tasks may still run.
    """
    trial_fleet = create_trial_fleet(fleet, f"{scheme.name.replace(' ', '-')}-{repetition}", before)
    recorder = TrialRecorder(experiment.until)
    means = EventMeans(fleet=trial_fleet, ask=options.ask, ended=threading.Event())
    # Draws of a policy are those of the repetition, as the times of events.
    policy = replace(scheme.policy, seed=repetition)
    draw_uniform = build_uniform_draw(str(repetition))
    with EventPerformer(experiment.events, means, draw_uniform, until=experiment.until) as performer:
        watch_options = _build_watch_options(trial_fleet, experiment, policy, recorder, performer, options)
        first = replace(trial_fleet, tasks=select_present_tasks(fleet.tasks, experiment.events, ()))
        if not _watch_mission(first, experiment, recorder, watch_options, options.listener):
            return None
        ended = trial_fleet.clock()
        events = performer.finish()
    ssim = _score_maps(trial_fleet, experiment, recorder.places, options.spec_directory)
    return recorder.build_trial(
        scheme.name, repetition, limit=experiment.limit, ended=ended, ssim=ssim, events=events
    )


def _build_watch_options(
    trial_fleet: Fleet,
    experiment: Experiment,
    policy: Policy,
    recorder: TrialRecorder,
    performer: EventPerformer,
    options: TrialOptions,
) -> WatchOptions:
    def begin_and_get_policy(_fleet: Fleet) -> Policy:
        """The policy; a mission begins with its first plan."""
        performer.begin_mission()
        return policy

    window = min(_TRIAL_PROBE_WINDOW_S, experiment.every / 2)
    return WatchOptions(
        every=experiment.every,
        apply=True,
        debug=options.debug,
        probe=ProbeOptions(window=window, timeout=_TRIAL_PROBE_TIMEOUT_S, totals=True),
        policy=begin_and_get_policy,
        refresh=_build_refresh(trial_fleet, experiment, performer),
        on_sample=performer.see_snapshot,
        execution=ApplyOptions(progress=lambda event: recorder.record_progress(event, trial_fleet.clock())),
        control=options.control,
    )


def _build_refresh(
    trial_fleet: Fleet, experiment: Experiment, performer: EventPerformer
) -> Callable[[], Fleet | None]:
    """The fleet with the tasks that have entered, whenever there are more of them than at the last call."""
    present = select_present_tasks(trial_fleet.tasks, experiment.events, ()).tasks.keys()

    def refresh() -> Fleet | None:
        nonlocal present
        tasks = select_present_tasks(trial_fleet.tasks, experiment.events, performer.happened)
        if tasks.tasks.keys() == present:
            return None
        present = tasks.tasks.keys()
        return replace(trial_fleet, tasks=tasks)

    return refresh


def _watch_mission(
    fleet: Fleet,
    experiment: Experiment,
    recorder: TrialRecorder,
    watch_options: WatchOptions,
    listener: CycleListener,
) -> bool:
    """Watch until the mission is over, at its limit at the latest; False where it was interrupted."""
    began = fleet.clock()
    with closing(watch_fleet(fleet, watch_options)) as cycles:
        for cycle in cycles:
            recorder.record_cycle(cycle)
            listener(recorder, cycle)
            over = fleet.clock() - (recorder.began or began) >= experiment.limit
            if recorder.finished or recorder.has_given_up or over:
                _record_closing(cycles, recorder, watch_options.control)
                return True
    return False


def _record_closing(cycles: Iterator[Cycle], recorder: TrialRecorder, control: Control) -> None:
    """Sample once more without a plan: by the usage after the mission its own is told apart (ADR 0132)."""
    paused, control.paused = control.paused, True
    try:
        closing = next(cycles, None)
    finally:
        control.paused = paused
    if closing is not None and closing.snapshot is not None:
        recorder.record_closing(closing.snapshot)


def clean_up_trials(fleet: Fleet) -> None:
    """Undo what events of trials have left, stop their tasks, verify that they have stopped, and delete the
    state of the trials.

    Tasks that another edgectl has started or changed since are left alone. The caller holds the fleet's lock.

    Raises:
        FleetBusyError: a change is not undone, a task does not stop, or a host that may run one does not
            answer.
    """
    for trial_fleet in reopen_trial_fleets(fleet):
        undo_held_changes(trial_fleet)
        generations = load_started_generations(trial_fleet)
        unchanged = is_fleet_state_unchanged(fleet, trial_fleet)
        snapshot = _stop_trial_tasks(trial_fleet, generations) if unchanged else _probe_all_hosts(trial_fleet)
        ended = sorted(
            instance
            for instance, (task, generation) in collect_ended_instances(snapshot).items()
            if generation <= generations.get(task, -1)
        )
        delete_trial_state(fleet, trial_fleet, ended, release=unchanged)


def _stop_trial_tasks(trial_fleet: Fleet, generations: Mapping[str, int]) -> Snapshot:
    """Stop the tasks that the trial started. Later starts, by anyone, have a higher generation."""
    names: list[str] = []
    for _ in range(_STOP_ATTEMPTS):
        with lock_fleet(trial_fleet, "stop", ApplyOptions()) as held:
            snapshot = _probe_all_hosts(held)
            names = _select_trial_tasks(snapshot, generations)
            if not names:
                return snapshot
            plan = build_stop_plan(names, trial_fleet.inventory, trial_fleet.tasks, snapshot)
            confirm_and_execute(held, plan, confirm_always, ApplyOptions(), verb="stop")
    raise FleetBusyError(
        f"{', '.join(names)} did not stop", hint=f"run edgectl stop {names[0]} to see the reason"
    )


def _select_trial_tasks(snapshot: Snapshot, generations: Mapping[str, int]) -> list[str]:
    """Running tasks of which all instances were started by the trial."""
    return [
        name
        for name, hosts in list_running_instances(snapshot).items()
        if all(snapshot.hosts[host].tasks[name].generation <= generations.get(name, -1) for host in hosts)
    ]


def _probe_all_hosts(fleet: Fleet) -> Snapshot:
    snapshot = probe_fleet(fleet, ProbeOptions(window=_CHECK_WINDOW_S, timeout=_CHECK_TIMEOUT_S))
    check_all_hosts_answered(snapshot)
    return snapshot


def check_all_hosts_answered(snapshot: Snapshot) -> None:
    """Refuse a snapshot in which a host did not answer.

    Raises:
        FleetBusyError: a host did not answer.
    """
    for name, host in snapshot.hosts.items():
        if not host.ok:
            raise FleetBusyError(
                f"{name} does not answer: {host.error}", hint=host.hint or f"edgectl doctor {name}"
            )


def _score_maps(
    fleet: Fleet, experiment: Experiment, places: Mapping[str, str], spec_directory: Path
) -> dict[str, float]:
    """SSIM by column of the maps that the tasks wrote.

    A map that cannot be read is a warning and has no value.
    """
    scores = {}
    for column, pair in experiment.maps.items():
        if pair.task not in places:
            fleet.warn(f"{column}: no map, because {pair.task} never ran")
            continue
        host = places[pair.task]
        try:
            scores[column] = _score_map(fleet, pair, host, spec_directory)
        except EdgectlError as error:
            fleet.warn(f"{column}: no map of {pair.task} from {host}: {error.message}")
    return scores


def _score_map(fleet: Fleet, pair: MapPair, host_name: str, spec_directory: Path) -> float:
    from edgectl.experiments.map_comparison import compare_maps

    host, task = fleet.inventory.hosts[host_name], fleet.tasks.tasks[pair.task]
    return compare_maps(
        pair.file,
        lambda file: fetch_file(fleet.transport, host, task, file, timeout=_FETCH_TIMEOUT_S),
        spec_directory / pair.truth,
    )
