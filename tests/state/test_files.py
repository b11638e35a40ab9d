# SPDX-License-Identifier: Apache-2.0
"""Manager state, measured links and directories: private, written atomically or not at all, never fatal when
damaged.
"""

import dataclasses
import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from edgectl.errors import LockBusyError, StateError
from edgectl.model.link_reading import LinkHistory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.state import failpoints, fleet_dir
from edgectl.state.fleet_dir import ensure_fleet_dir
from edgectl.state.json_files import read_json, write_json
from edgectl.state.link_readings import load_link_histories, save_link_histories
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import (
    load_link_capacities,
    load_manager_state,
    save_link_capacities,
    save_manager_state,
)
from edgectl.state.paths import ensure_private_dir, get_legacy_path, get_state_root

MEMORY = ManagerState(
    managed=True,
    placements={"slam": Placement(host="edge1", since=1000.0, spec_hash="abc", generation=3)},
    first={"slam": "edge2"},
    cordons=frozenset({"edge3"}),
    done={"job": "def"},
    downtimes={("slam", "edge1"): (1.5, 2.25)},
)


def test_memory_survives(tmp_path: Path) -> None:
    assert load_manager_state(tmp_path) == ManagerState()
    save_manager_state(tmp_path, MEMORY)
    assert load_manager_state(tmp_path) == MEMORY
    assert (tmp_path / "memory.json").stat().st_mode & 0o777 == 0o600


def test_a_broken_memory_is_set_aside_and_the_previous_one_used(tmp_path: Path) -> None:
    save_manager_state(tmp_path, MEMORY)
    save_manager_state(tmp_path, dataclasses.replace(MEMORY, cordons=frozenset()))
    (tmp_path / "memory.json").write_text("{")
    said: list[str] = []
    assert load_manager_state(tmp_path, said.append) == MEMORY
    assert "set aside as memory.json.broken-1" in said[0]
    assert (tmp_path / "memory.json.broken-1").read_text() == "{"


def test_every_truncation_of_memory_is_survived(tmp_path: Path) -> None:
    save_manager_state(tmp_path, MEMORY)
    data = (tmp_path / "memory.json").read_bytes()
    for length in range(len(data) - 2):
        (tmp_path / "memory.json").write_bytes(data[:length])
        said: list[str] = []
        assert load_manager_state(tmp_path, said.append) == ManagerState()
        assert len(said) == 1
        (tmp_path / "memory.json.broken-1").unlink()


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "null",
        '{"format_version": 1, "managed": "yes"}',
        "[" * 100_000,
        "\x00",
        '{"format_version": 1, "placements": 3}',
    ],
)
def test_odd_memory_is_survived(tmp_path: Path, text: str) -> None:
    (tmp_path / "memory.json").write_text(text)
    said: list[str] = []
    assert load_manager_state(tmp_path, said.append) == ManagerState()
    assert said


def test_a_newer_memory_is_refused_and_kept(tmp_path: Path) -> None:
    (tmp_path / "memory.json").write_text(json.dumps({"format_version": 99}))
    with pytest.raises(StateError, match="newer edgectl"):
        load_manager_state(tmp_path)
    assert (tmp_path / "memory.json").exists()


def test_a_cut_off_save_leaves_the_old_memory(tmp_path: Path) -> None:
    save_manager_state(tmp_path, MEMORY)

    def cut(point: str) -> None:
        if point == "state temp written":
            raise KeyboardInterrupt

    remove = failpoints.install_hook(cut)
    try:
        with pytest.raises(KeyboardInterrupt):
            save_manager_state(tmp_path, ManagerState())
    finally:
        remove()
    assert load_manager_state(tmp_path) == MEMORY
    assert (tmp_path / "memory.json.tmp").exists()
    save_manager_state(tmp_path, ManagerState())
    assert load_manager_state(tmp_path) == ManagerState()
    assert not list(tmp_path.glob("*.tmp")), "what a killed edgectl left behind is used by the next one"


def test_two_writers_at_once_leave_one_whole_document(tmp_path: Path) -> None:
    path = tmp_path / "links.json"
    documents = [{"writer": writer, "filler": "x" * 20_000 * (writer + 1)} for writer in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda number: write_json(path, documents[number % 4]), range(80)))
    assert read_json(path) in documents
    assert not list(tmp_path.glob("*.tmp"))


def test_measured_links_survive_and_broken_ones_are_survived(tmp_path: Path) -> None:
    save_link_capacities(tmp_path, {("edge1", "robot1"): 1e6, ("edge1", "robot2"): 2.5e6})
    assert load_link_capacities(tmp_path) == {("edge1", "robot1"): 1e6, ("edge1", "robot2"): 2.5e6}
    (tmp_path / "links.json").write_text('{"format_version": 1, "links": {"edge1": {"robot1": -1}}}')
    said: list[str] = []
    assert load_link_capacities(tmp_path, said.append) == {}
    assert "links.edge1.robot1: must be 0 or more, not -1" in said[0]


def test_each_fleet_has_a_directory_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    old = os.umask(0)
    try:
        one, other = (
            ensure_fleet_dir("lab", tmp_path / "lab.yaml"),
            ensure_fleet_dir("hall", tmp_path / "lab.yaml"),
        )
    finally:
        os.umask(old)
    assert one != other
    assert one.parent == get_state_root() / "fleets"
    assert (one.name, other.name) == ("lab", "hall")
    assert {path.stat().st_mode & 0o777 for path in (one, other, get_state_root())} == {0o700}


def test_the_state_of_the_first_release_is_taken_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its directory was named by the path of the inventory; after that the file may be renamed."""
    monkeypatch.setattr(fleet_dir, "_WAIT_S", 0.0)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    file = tmp_path / "lab.yaml"
    legacy = ensure_private_dir(get_legacy_path(file))
    (legacy / "memory.json").write_text("{}")
    with FleetLock(legacy), pytest.raises(LockBusyError, match="lock held by"):
        ensure_fleet_dir("lab", file)
    taken = ensure_fleet_dir("lab", file)
    assert ((taken / "memory.json").read_text(), legacy.exists()) == ("{}", False)
    assert ensure_fleet_dir("lab", tmp_path / "renamed.yaml") == taken


def test_a_directory_that_others_may_write_is_refused(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    with pytest.raises(StateError, match="not private"):
        ensure_private_dir(shared)


def test_a_link_in_place_of_the_lock_is_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("")
    (tmp_path / "memory.json").symlink_to(tmp_path / "elsewhere")
    save_manager_state(tmp_path, MEMORY)
    assert (tmp_path / "elsewhere").read_text() == ""


@pytest.mark.parametrize(
    ("mode", "owner", "refused"),
    [(0o777, 0, True), (0o1777, 0, False), (0o755, 1002, True), (0o755, 0, False)],
)
def test_a_directory_above_that_another_user_may_exchange_is_refused(
    tmp_path: Path, mode: int, owner: int, refused: bool
) -> None:
    """Whoever can rename the state directory can put another one in its place while a lock is held."""
    if os.geteuid() != 0:
        pytest.skip("only root can make the directory of another user")
    above = tmp_path / "eve"
    above.mkdir()
    above.chmod(mode)
    os.chown(above, owner, 0)
    if not refused:
        assert ensure_private_dir(above / "state").is_dir()
        return
    with pytest.raises(StateError, match="which another user may change") as raised:
        ensure_private_dir(above / "state")
    assert f"chmod go-w {above}" in raised.value.hint


def test_readings_of_links_are_read_again_only_where_the_file_was_replaced(tmp_path: Path) -> None:
    """The same objects: nothing was decoded anew. Whoever changes what was returned changes nothing here."""
    pair, warnings = ("edge2", "robot1"), list[str]()
    assert load_link_histories(tmp_path) == {}
    save_link_histories(tmp_path, {pair: LinkHistory(answered=True)})
    found = load_link_histories(tmp_path)
    assert load_link_histories(tmp_path)[pair] is found[pair]
    found.clear()
    assert load_link_histories(tmp_path) == {pair: LinkHistory(answered=True)}
    save_link_histories(tmp_path, {pair: LinkHistory(silent=2)})
    assert load_link_histories(tmp_path) == {pair: LinkHistory(silent=2)}
    (tmp_path / "live-links.json").write_text("no JSON")
    (tmp_path / "live-links.json.previous").unlink(missing_ok=True)
    assert load_link_histories(tmp_path, warnings.append) == {}
    assert len(warnings) == 1
    assert load_link_histories(tmp_path, warnings.append) == {}
    assert len(warnings) == 1
