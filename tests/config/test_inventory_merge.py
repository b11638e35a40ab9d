"""Several inventories that make one fleet together."""

from pathlib import Path

import pytest

from edgectl.config.load import load_inventory, load_inventory_and_tasks
from edgectl.errors import InputError

EDGES = "version: 1\nfleet: lab\ndefaults: {user: ana}\nedges:\n  edge9: {host: e9}\n  edge1: {host: e1}\n"
ROBOTS = (
    "version: 1\ndefaults: {user: bob}\nrobots:\n  robot2: {host: r2}\n"
    "links:\n- {edge: edge9, robot: robot2, throughput: 5MB/s}\n"
)
MORE = "version: 1\nedges:\n  edge5: {host: e5}\n"


def write(folder: Path, **texts: str) -> list[Path]:
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)
    return [folder / f"{name}.yaml" for name in texts]


def problems_of(files: list[Path]) -> list[tuple[str, int, str, str]]:
    with pytest.raises(InputError) as caught:
        load_inventory(files)
    return [
        (Path(each.file).name, each.line, each.message, each.hint)
        for each in caught.value.problems
        if not each.warning
    ]


def test_the_order_of_the_files_does_not_matter(tmp_path: Path) -> None:
    files = write(tmp_path, zulu=EDGES, mike=ROBOTS, alfa=MORE)
    one, other = load_inventory(files), load_inventory(list(reversed(files)))
    assert one == other
    assert list(one.hosts) == ["edge1", "edge5", "edge9", "robot2"]
    assert [host.user for host in one.hosts.values()] == ["ana", None, "ana", "bob"]
    assert one.links == {("edge9", "robot2"): 5e6}
    assert (one.fleet, {host.fleet for host in one.hosts.values()}) == ("lab", {"lab"})


def test_a_host_in_two_files_names_both_places(tmp_path: Path) -> None:
    files = write(tmp_path, one=EDGES, two=MORE + "  edge1: {host: x}\n")
    assert problems_of(files) == [
        ("two.yaml", 4, f"edge1 is already defined in {files[0]}, line 6", "rename or remove one of the two")
    ]


def test_the_fleet_has_one_name_that_a_file_states(tmp_path: Path) -> None:
    unnamed = write(tmp_path, one=MORE, two=ROBOTS.split("links")[0])
    assert problems_of(unnamed) == [
        (
            "one.yaml",
            1,
            "none of the 2 inventories names the fleet that they make together",
            "add fleet: NAME to one of them",
        )
    ]
    twice = write(tmp_path, one=EDGES, two=MORE.replace("edges", "fleet: plant\nedges"))
    assert problems_of(twice) == [
        (
            "two.yaml",
            2,
            f"fleet is stated differently in {twice[0]}, line 2",
            "keep fleet in one file, or write the same in both",
        )
    ]
    same = write(tmp_path, one=EDGES, two=MORE.replace("edges", "fleet: lab\nedges"))
    assert load_inventory(same).fleet == "lab"


def test_a_broken_file_of_several_is_the_only_one_named(tmp_path: Path) -> None:
    files = write(tmp_path, one=EDGES, two="version: 1\nedges: {edge5: {hots: e5}}\n")
    assert [(name, line) for name, line, _, _ in problems_of(files)] == [("two.yaml", 2), ("two.yaml", 2)]
    assert [name for name, *_ in problems_of([files[0], tmp_path / "gone.yaml"])] == ["gone.yaml"]


def test_task_files_have_the_same_id_in_any_order(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    files = [*write(tmp_path, one=EDGES), *write(tmp_path / "b", two=ROBOTS)]
    tasks = tmp_path / "work.yaml"
    tasks.write_text("version: 1\ntasks:\n  nav: {robot: robot2, command: 'true'}\n")
    ids = {load_inventory_and_tasks(order, tasks)[1].files for order in (files, list(reversed(files)))}
    assert ids == {frozenset({"work.yaml"})}


def test_programs_for_events_of_all_files_count_in_an_order_of_their_own(tmp_path: Path) -> None:
    hooks = "on_event:\n- {{command: [{0}]}}\n"
    files = write(tmp_path, zulu=EDGES + hooks.format("mail"), alfa=MORE + hooks.format("chat"))
    one, other = load_inventory(files), load_inventory(list(reversed(files)))
    assert one == other
    assert [hook.command for hook in one.on_event] == [("chat",), ("mail",)]
