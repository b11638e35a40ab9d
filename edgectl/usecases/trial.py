"""One trial of an experiment: a manager without a past deploys, watches until the mission is over, and leaves nothing behind."""

import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from edgectl.errors import EdgectlError, FleetBusyError
from edgectl.evidence.recorder import Recorder
from edgectl.executor.manual import running, stop_plan
from edgectl.gateway.collect import ProbeOptions
from edgectl.gateway.fetch import fetch
from edgectl.model.cycle import Cycle
from edgectl.model.evidence import Variant
from edgectl.model.experiment import Experiment, MapPair, Trial
from edgectl.model.memory import Memory
from edgectl.model.snapshot import Snapshot, TaskState
from edgectl.state.files import FORMAT_VERSION, read_json, write_json
from edgectl.state.journal import NAME as JOURNAL
from edgectl.state.journal import Journal
from edgectl.state.journal_read import standing
from edgectl.state.keeper import Keeper
from edgectl.state.links import load_links, save_links
from edgectl.state.memory import load_memory, save_memory
from edgectl.state.paths import private_dir
from edgectl.state.reopened import load_reopened, save_reopened
from edgectl.state.stamp import stamp
from edgectl.usecases.change import ApplyOptions, agreed, carry_out, changing
from edgectl.usecases.control import Control
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.probe import probe
from edgectl.usecases.watch import WatchOptions, watch

# A window in which use is measured is never most of a cycle; a host that hangs does not hold one up for long.
_WINDOW_S, _PROBE_S = 0.5, 10.0
_LOOK_S, _PATIENCE_S = 0.1, 30.0
_FETCH_S = 60.0
_STOPS = 3
_PREFIX, _STAMP = "trial-", "before.json"
Seen = Callable[[Recorder, Cycle], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialOptions:
    """``beside``: where the truth of maps is looked for. ``seen`` hears of every cycle. ``control`` ends the trial early.

    ``debug``: a bug ends the trial, instead of its cycle alone.
    """

    beside: Path
    seen: Seen
    control: Control
    debug: bool = False


def trial(fleet: Fleet, experiment: Experiment, variant: Variant, repetition: int, before: Snapshot, options: TrialOptions) -> Trial | None:
    """Run one trial on a fleet that is idle, as ``before`` shows it; None where ``control`` ended it. Tasks may be left: `clear` follows.

    Call it with the fleet's lock held.
    """
    own = _newcomer(fleet, f"{_PREFIX}{variant.name.replace(' ', '-')}-{repetition}", before)
    recorder = Recorder(experiment.until)
    given = WatchOptions(
        every=experiment.every,
        apply=True,
        debug=options.debug,
        probe=ProbeOptions(window=min(_WINDOW_S, experiment.every / 2), timeout=_PROBE_S),
        policy=lambda _: variant.policy,
        progress=lambda event: recorder.hear(event, own.clock()),
        control=options.control,
    )
    began = own.clock()
    with closing(watch(own, given)) as cycles:  # type: ignore[type-var]
        for cycle in cycles:
            recorder.see(cycle)
            options.seen(recorder, cycle)
            if recorder.finished or recorder.hopeless or own.clock() - (recorder.began or began) >= experiment.limit:
                break
        else:
            return None
    ended = own.clock()
    ssim = _similarities(own, experiment, recorder.places, options.beside)
    return recorder.trial(variant.name, repetition, limit=experiment.limit, ended=ended, ssim=ssim)


def _newcomer(fleet: Fleet, name: str, before: Snapshot) -> Fleet:
    """The fleet for a manager that remembers nothing but what an operator said of the hosts and what was measured of the links.

    What ended on a host earlier counts no longer. The clock is one that nobody sets.
    """
    state = private_dir(fleet.state / name)
    began, since = fleet.clock(), fleet.uptime().seconds
    said = load_memory(fleet.state, fleet.warn)
    write_json(state / _STAMP, _before(fleet), keep=False)
    save_memory(state, Memory(cordons=said.cordons, draining=said.draining))
    save_links(state, load_links(fleet.state, fleet.warn))
    save_reopened(state, tuple(dict.fromkeys((*load_reopened(fleet.state, fleet.warn), *_over(before)))))
    _pass_holds_on(fleet, fleet.state, state, released=False)
    return replace(fleet, state=state, history=Keeper(), clock=lambda: began + fleet.uptime().seconds - since)


def _over(snapshot: Snapshot) -> dict[str, tuple[str, int]]:
    """Task and generation of the instances that have ended and would not be started again."""
    return {
        sample.instance: (task, sample.generation)
        for host in snapshot.hosts.values()
        for task, sample in host.tasks.items()
        if sample.state is TaskState.COMPLETED or sample.given_up
    }


def _before(fleet: Fleet) -> dict[str, object]:
    """How the fleet's own files stand: no other edgectl changes the fleet without changing them."""
    return {"format_version": FORMAT_VERSION, "stamp": [each and list(each) for each in stamp(fleet.state)]}


def clear(fleet: Fleet) -> None:
    """Stop what trials left running, with proof, and forget them. Call it with the fleet's lock held.

    What another edgectl has taken over since is not touched.

    Raises:
        FleetBusyError: a task does not stop, or a host that may run one does not answer.
    """
    for state in sorted(fleet.state.glob(f"{_PREFIX}*")):
        own = replace(fleet, state=private_dir(state), history=Keeper())
        known, untouched = _generations(own), _untouched(fleet, state)
        snapshot = _emptied(own, known) if untouched else _asked(own)
        ended = sorted(instance for instance, (task, generation) in _over(snapshot).items() if generation <= known.get(task, -1))
        save_reopened(fleet.state, (*load_reopened(fleet.state, fleet.warn), *ended))
        _pass_holds_on(fleet, state, fleet.state, released=untouched)
        shutil.rmtree(state)


def _pass_holds_on(fleet: Fleet, source: Path, target: Path, *, released: bool) -> None:
    """A robot that was told to hold is let go by whoever steers it next, so its hold outlives the journal that knows of it."""
    held, known = set(standing(source / JOURNAL).held), set(standing(target / JOURNAL).held)
    told = [*(("phase", task) for task in held - known), *(("released", task) for task in known - held if released)]
    if told:
        with Journal.open(target, clock=fleet.clock, warn=fleet.warn) as journal:
            for event, task in sorted(told):
                journal.append(event, task=task, **({"phase": "hold"} if event == "phase" else {}))


def _untouched(fleet: Fleet, state: Path) -> bool:
    try:
        return read_json(state / _STAMP) in (None, _before(fleet))
    except ValueError:
        return False


def _emptied(own: Fleet, known: Mapping[str, int]) -> Snapshot:
    """The fleet without the tasks that this trial started; a later start, by whomever, has a higher generation and is left alone."""
    names: list[str] = []
    for _ in range(_STOPS):
        snapshot = _asked(own)
        places = running(snapshot)
        names = [
            name for name in places if all(snapshot.hosts[host].tasks[name].generation <= known.get(name, -1) for host in places[name])
        ]
        if not names:
            return snapshot
        with changing(own, "stop", ApplyOptions()) as held:
            carry_out(held, stop_plan(names, own.inventory, own.tasks, snapshot), agreed, ApplyOptions(), verb="stop")
    raise FleetBusyError(f"{', '.join(names)} did not stop", hint=f"edgectl stop {names[0]} says why")


def _asked(own: Fleet) -> Snapshot:
    """What runs where; every host has to say."""
    snapshot = probe(own, ProbeOptions(window=_LOOK_S, timeout=_PATIENCE_S))
    refuse_silence(snapshot)
    return snapshot


def refuse_silence(snapshot: Snapshot) -> None:
    """See that every host answered.

    Raises:
        FleetBusyError: one did not.
    """
    for name, host in snapshot.hosts.items():
        if not host.ok:
            raise FleetBusyError(f"{name} does not answer: {host.error}", hint=host.hint or f"edgectl doctor {name}")


def _generations(own: Fleet) -> dict[str, int]:
    """By task, the highest generation that this trial may have started."""
    with Journal.open(own.state, clock=own.clock, warn=own.warn) as journal:
        known = dict(journal.log.generations)
    for name, placement in load_memory(own.state, own.warn).placements.items():
        known[name] = max(known.get(name, 0), placement.generation)
    return known


def _similarities(own: Fleet, experiment: Experiment, places: Mapping[str, str], beside: Path) -> dict[str, float]:
    """The maps that the tasks left against their truths. One that cannot be had is said, and has no value."""
    found = {}
    for column, pair in experiment.maps.items():
        if pair.task not in places:
            own.warn(f"{column}: {pair.task} never ran, so there is no map")
            continue
        try:
            found[column] = _similarity(own, pair, places[pair.task], beside)
        except EdgectlError as error:
            own.warn(f"{column}: no map of {pair.task} from {places[pair.task]}: {error.message}")
    return found


def _similarity(own: Fleet, pair: MapPair, place: str, beside: Path) -> float:
    from edgectl.usecases.maps import similarity

    host, task = own.inventory.hosts[place], own.tasks.tasks[pair.task]
    return similarity(pair.file, lambda file: fetch(own.transport, host, task, file, timeout=_FETCH_S), beside / pair.truth)
