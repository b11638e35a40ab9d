# SPDX-License-Identifier: Apache-2.0
"""Heartbeat times never go back and never extend a silence; fences are cleared when a host answers."""

import threading
from pathlib import Path

import pytest

from edgectl.errors import StateError
from edgectl.state.heartbeats import Heartbeats, add_fences, load_heartbeats, record_heartbeats, remove_fences
from edgectl.state.uptime import Uptime, compute_elapsed_s, read_uptime


def a_reachable_fleet(seconds: float, boot: str = "a") -> Uptime:
    return Uptime(boot=boot, seconds=seconds)


def test_a_contact_only_becomes_later(tmp_path: Path) -> None:
    record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(10.0), "edge2": a_reachable_fleet(5.0)})
    record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(4.0), "edge2": a_reachable_fleet(7.0)})
    assert load_heartbeats(tmp_path).last == {
        "edge1": a_reachable_fleet(10.0),
        "edge2": a_reachable_fleet(7.0),
    }
    record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(1.0, "b")})
    assert load_heartbeats(tmp_path).last["edge1"] == a_reachable_fleet(1.0, "b")


def test_a_file_that_nobody_replaced_is_read_once(tmp_path: Path) -> None:
    """Another process may replace it, or remove it, at any time."""
    record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(10.0)})
    known = load_heartbeats(tmp_path)
    assert load_heartbeats(tmp_path) is known
    path = tmp_path / "contacts.json"
    other = tmp_path / "other"
    other.write_text(path.read_text().replace("10", "90"))
    other.replace(path)
    assert load_heartbeats(tmp_path).last == {"edge1": a_reachable_fleet(90.0)}
    path.unlink()
    assert load_heartbeats(tmp_path).last == {}


def test_commands_at_once_lose_no_contact(tmp_path: Path) -> None:
    writers = [
        threading.Thread(target=record_heartbeats, args=(tmp_path, {f"edge{number}": a_reachable_fleet(1.0)}))
        for number in range(8)
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert len(load_heartbeats(tmp_path).last) == 8


def test_the_wall_clock_does_not_count_and_a_restart_never_lengthens_a_silence() -> None:
    assert compute_elapsed_s(a_reachable_fleet(10.0), a_reachable_fleet(70.0)) == 60.0
    assert compute_elapsed_s(a_reachable_fleet(10_000.0), a_reachable_fleet(30.0, "b")) == 30.0
    assert compute_elapsed_s(a_reachable_fleet(50.0, ""), a_reachable_fleet(30.0, "")) == 30.0
    assert Heartbeats(last={"edge1": a_reachable_fleet(10.0)}).to_instants(
        1000.0, a_reachable_fleet(70.0)
    ) == {"edge1": 940.0}
    assert compute_elapsed_s(read_uptime(), read_uptime()) >= 0.0


def test_a_host_that_answers_is_not_off(tmp_path: Path) -> None:
    assert add_fences(tmp_path, ["edge1", "edge2"]).fenced == {"edge1", "edge2"}
    record_heartbeats(tmp_path, {"edge2": a_reachable_fleet(1.0)})
    assert load_heartbeats(tmp_path).fenced == {"edge1"}
    assert remove_fences(tmp_path, ["edge1"]).fenced == frozenset()


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"last": 1, "fenced": []}', '{"last": {"e": {"boot": "a", "uptime_s": -1}}, "fenced": []}'],
)
def test_a_broken_file_means_that_nothing_is_known_and_an_older_one_is_not_believed(
    text: str, tmp_path: Path
) -> None:
    record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(1.0)})
    record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(2.0)})
    (tmp_path / "contacts.json").write_text(text)
    said: list[str] = []
    assert load_heartbeats(tmp_path, said.append) == Heartbeats()
    assert "is broken" in said[0]
    assert (tmp_path / "contacts.json.broken-1").exists()


def test_a_file_of_a_newer_edgectl_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "contacts.json").write_text('{"format_version": 2}')
    with pytest.raises(StateError, match="newer edgectl"):
        record_heartbeats(tmp_path, {"edge1": a_reachable_fleet(1.0)})
