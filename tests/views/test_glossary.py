# SPDX-License-Identifier: Apache-2.0
"""Every document of every view, key by key, against the glossary; and the page that lists it."""

import dataclasses
from collections.abc import Iterator
from datetime import datetime
from importlib import import_module
from pkgutil import iter_modules

import pytest

import edgectl.experiments.views
import edgectl.views
from edgectl.config.key_reference import find_reference
from edgectl.experiments.views.experiment import ExperimentView
from edgectl.experiments.views.map_score import MapScoreView
from edgectl.experiments.views.replay import ReplayView
from edgectl.formats.document import Document
from edgectl.model.cycle import Cycle
from edgectl.model.event import EventHook
from edgectl.model.host_key import HostKeyReport
from edgectl.model.resource import RESOURCES
from edgectl.rules.awaited_state import AwaitedState, TaskProgress
from edgectl.views.byte_counters import ByteCountersView
from edgectl.views.config import ContextRow, ContextsView, Setting, SettingsView
from edgectl.views.describe import DetailsView
from edgectl.views.diagnosis import DiagnosisView
from edgectl.views.diff import DiffView
from edgectl.views.dry_run import RequestsView
from edgectl.views.events import EventsView
from edgectl.views.explanation import ExplanationView
from edgectl.views.glossary import KeyEntry, KeyType, list_keys
from edgectl.views.graph import TaskGraphView
from edgectl.views.history import HistoryView, RevisionView
from edgectl.views.hook_trials import HookTrialsView
from edgectl.views.host_keys import HostKeysView
from edgectl.views.listing import AllListingsView, ListingChangesView
from edgectl.views.listing_items import ListingKind, compare_listings
from edgectl.views.marks import Mark, MarksView
from edgectl.views.output import EnvelopeView, ItemView, ListView, View
from edgectl.views.profile import ProfileView
from edgectl.views.profilers import ProfilersView
from edgectl.views.reference import ReferenceView
from edgectl.views.results import DrainView
from edgectl.views.status import StatusView
from edgectl.views.wait import WaitView
from edgectl.views.watch_cycle import CycleView
from tests.builders import NOW
from tests.experiments import test_experiment_view, test_simulation_and_replay_views, test_sweep_command
from tests.scheduler.test_standbys import a_copy
from tests.views import (
    test_byte_counters,
    test_demands,
    test_describe,
    test_diagnosis,
    test_explanation,
    test_forms,
    test_listing,
    test_live,
    test_past,
    test_profilers,
    test_standbys,
    test_top,
)
from tests.views.fixtures import ROOT, plan
from tests.views.outputs_page import render_outputs_page

GLOSSARY = {entry.key: entry for entry in list_keys()}
REQUEST = {"host": "edge1", "phase": "start", "task": "slam", "command": "python3 -", "stdin": {"any": [1]}}


def list_views() -> Iterator[View]:
    yield from (view for what, view in test_forms.views().items() if what not in ("plan", "snapshot"))
    yield DiffView(plan())
    yield TaskGraphView(plan(), test_listing.TASKS)
    yield ReferenceView(find_reference("task.demand"))
    yield AllListingsView(
        [test_listing.listed(kind) for kind in (ListingKind.HOSTS, ListingKind.TASKS, ListingKind.LINKS)]
    )
    yield from map(test_describe.host_view, ("edge1", "edge2", "robot1"))
    yield from (test_describe.task_view(), test_describe.task_view("idle"))
    yield DetailsView([test_describe.host_view("edge1"), test_describe.task_view()])
    yield from (test_top.hosts_view(), test_top.tasks_view(test_top.saying()))
    listing = test_listing.listed(ListingKind.TASKS)
    yield ListingChangesView(listing, compare_listings(None, listing), None)
    yield from (test_listing.listing_view(kind) for kind in ListingKind)
    yield StatusView(test_past.SNAPSHOT, test_past.FLEET, test_listing.TASKS)
    yield StatusView(test_standbys.a_fleet(a_copy()), test_standbys.INVENTORY, test_standbys.TASKS)
    yield from (HistoryView(test_past.PAST), RevisionView(test_past.PAST[0]))
    yield DrainView([test_forms.RESULTS], [("slam", "edge1")], done=False)
    yield RequestsView([REQUEST])
    yield EventsView(test_describe.EVENTS)
    yield from (
        ByteCountersView(test_byte_counters.FOUND),
        ProfilersView(test_profilers.FOUND),
        DiagnosisView(test_diagnosis.FOUND),
        HookTrialsView([(EventHook(command=("mail",)), "failed", 0.25)]),
    )
    yield ExplanationView(*test_explanation.taken_apart())
    yield ExplanationView(*test_explanation.with_latency())
    yield ProfileView([test_demands.a_profile()])
    yield CycleView(test_live.cycle(results=test_live.results(test_live.MOVED), events=(test_live.EVENT,)))
    yield from (CycleView(test_live.cycle()), CycleView(Cycle(number=3, at=NOW, error="no", busy="held")))
    disturbed = dataclasses.replace(
        test_experiment_view.DONE[0],
        events=(test_experiment_view.EVENT,),
        recoveries={"link": test_experiment_view.EVENT.recoveries},
    )
    yield ExperimentView(
        run=test_experiment_view.RUN,
        results=[disturbed, *test_experiment_view.DONE[1:]],
        comparisons=test_experiment_view.COMPARED,
    )
    yield test_simulation_and_replay_views.VIEW
    yield test_sweep_command.VIEW
    yield ReplayView(results=[test_simulation_and_replay_views.REPLAYED])
    yield MapScoreView(0.5)
    yield HostKeysView(
        [HostKeyReport(host="edge1", key_type="ssh-ed25519", fingerprint="SHA256:x", state="known")]
    )
    yield SettingsView([Setting(name="tasks", values=("a", "b"), origin="-t")], ["no inventory"], origin=True)
    yield ContextsView(
        [ContextRow(name="lab", chosen=True, inventories=("lab.yaml",), tasks=(), origin="edgectl.yaml:3")]
    )
    yield MarksView("fence", [Mark(subject="edge", name="edge1", act="fenced")], dry_run=True)
    yield WaitView([TaskProgress(task="slam", reached=True, state="ready", host="edge1")], AwaitedState.READY)


VIEWS = list(list_views())


def find_faults(value: object, path: str, entry: KeyEntry | None = None) -> Iterator[str]:
    """Keys that the glossary does not have, and values that have another type."""
    if isinstance(value, dict):
        for key, each in value.items():
            known = None if entry is not None and entry.type is KeyType.MAP else GLOSSARY.get(key)
            where = f"{path}.{key}"
            if entry is not None and entry.type is KeyType.MAP:
                yield from find_faults(each, where) if isinstance(each, dict | list) else ()
            elif known is None:
                yield f"{where}: not in the glossary"
            elif each is not None and not has_type(each, known.type):
                yield f"{where}: not of type {known.type}"
            elif known.type is not KeyType.OPAQUE:
                yield from find_faults(each, where, known)
    elif isinstance(value, list):
        for each in value:
            yield from find_faults(each, f"{path}[]") if isinstance(each, dict) else ()


def has_type(value: object, kind: KeyType) -> bool:
    if kind is KeyType.INSTANT:
        return isinstance(value, str) and datetime.fromisoformat(value).tzinfo is not None
    types: dict[KeyType, type | tuple[type, ...]] = {
        KeyType.TEXT: str,
        KeyType.NUMBER: (int, float),
        KeyType.FLAG: bool,
        KeyType.LIST: list,
        KeyType.OBJECT: dict,
        KeyType.MAP: dict,
        KeyType.OPAQUE: object,
    }
    return isinstance(value, types[kind]) and isinstance(value, bool) <= (kind is KeyType.FLAG)


def encode(view: View) -> Document:
    return view.document()


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: type(view).__name__)
def test_every_key_is_in_the_glossary_with_one_type(view: View) -> None:
    assert sorted(set(find_faults(encode(view), type(view).__name__))) == []


def test_every_view_is_walked() -> None:
    for room in (edgectl.views, edgectl.experiments.views):
        for module in iter_modules(room.__path__):
            import_module(f"{room.__name__}.{module.name}")
    files = {"PlanView", "SnapshotView"}
    assert {each.__name__ for each in list_classes(View)} - files == {type(view).__name__ for view in VIEWS}


def list_classes(base: type[View]) -> Iterator[type[View]]:
    for each in base.__subclasses__():
        if each not in (EnvelopeView, ItemView, ListView):
            yield each
        yield from list_classes(each)


def test_a_key_of_the_glossary_is_in_some_document() -> None:
    used: set[str] = set()
    for view in VIEWS:
        collect_keys(encode(view), used)
    budgets = [resource for resource in RESOURCES if resource.optional]
    known = {resource.unit.name for resource in RESOURCES if not resource.optional}
    words = {word for each in budgets for word in ({each.unit.name} - known) | {each.name}}
    unstated = {key for key in GLOSSARY if any(word in key for word in words)}
    assert sorted(set(GLOSSARY) - used - unstated - NOT_IN_THE_SAMPLES) == []


# Of hosts, tasks and changes that no sample has.
NOT_IN_THE_SAMPLES = {
    "ended_at", "exit_code", "given_up", "gpu_share", "boot_id", "clock_skew_s", "enforcement", "partial", "log_tail", "level_dbm",
    "retries_per_s", "access_point", "joined_s", "counters",
    "latency", "count", "misses", "bound_ms", "p50_ms", "p95_ms", "p99_ms", "max_ms", "recent_s", "recent_count", "recent_misses",
    "object", "type", "speed_bytes_per_s", "resident", "user", "hold", "release", "proxy_jump", "cut_off_from",
    "pinned_at", "pinned_until", "max_temperature_c",
}  # fmt: skip


def collect_keys(value: object, found: set[str]) -> None:
    if isinstance(value, dict):
        found.update(value)
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        collect_keys(each, found)


def test_units_stand_in_the_names_of_numbers() -> None:
    assert len(GLOSSARY) == len(list_keys()), "one entry per key"
    assert {GLOSSARY[key].unit for key in ("used_bytes", "age_s", "rtt_ms", "used_bytes_per_s")} == {
        "bytes",
        "s",
        "ms",
        "bytes/s",
    }


def test_a_number_without_a_unit_is_none_of_a_quantity() -> None:
    words = ("second", "millisecond", "byte", "core", "watt", "degree", "volt")
    bare = [entry for entry in GLOSSARY.values() if entry.type is KeyType.NUMBER and not entry.unit]
    assert [e.key for e in bare if any(f"in {word}s" in e.meaning for word in words)] == []
    assert [e.key for e in bare if e.key.rpartition("_")[2] in ("s", "ms", "bytes", "cores", "watts")] == []


def test_the_page_lists_the_glossary() -> None:
    page = ROOT / "docs" / "reference" / "outputs.md"
    assert page.read_text() == render_outputs_page(), "python -m tests.views.outputs_page > " + str(page)
