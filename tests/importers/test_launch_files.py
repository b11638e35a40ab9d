# SPDX-License-Identifier: Apache-2.0
"""Launch files of both generations of ROS become task files that edgectl accepts.

``python -m tests.importers.test_launch_files`` writes the expected files again; read the difference.
"""

import contextlib
import os
from pathlib import Path

import pytest

from edgectl.cli.user_files import refuse_exposed_files
from edgectl.config.load import load_inventory_and_tasks
from edgectl.usecases.import_files import import_ros
from edgectl.usecases.import_result import Imported

CORPUS = Path(__file__).parent / "launch"
ARGUMENTS = {
    "args.launch": {"rate": "5"},
    "args.launch.xml": {"rate": "5", "mode": "fast"},
    "robots.launch.py": {"count": "3"},
}
LAUNCH_FILES = sorted(path.name for path in CORPUS.iterdir() if path.is_file() and ".launch" in path.name)


def import_from_corpus(name: str, *, by_file: bool = False) -> Imported:
    """Import a launch file as a user in the directory of the corpus does, with LAB_TOPIC set and LAB_OUT not."""
    before = dict(os.environ)
    os.environ["LAB_TOPIC"] = "/chatter"
    os.environ.pop("LAB_OUT", None)
    try:
        with contextlib.chdir(CORPUS):
            return import_ros(
                [name], ARGUMENTS.get(name, {}), ["."], by_file=by_file, refuse_exposed=refuse_exposed_files
            )
    finally:
        os.environ.clear()
        os.environ.update(before)


def render_import(made: Imported) -> str:
    """The task file, the hosts, and what is not imported."""
    hosts = "".join(
        line + "\n" for line in made.inventory.splitlines() if not line.startswith(("fleet", "#", "version"))
    )
    notes = "".join(f"# {Path(note.file).name}:{note.line}: {note.message}\n" for note in made.notes)
    return f"{made.tasks}--- hosts\n{hosts}--- not imported\n{notes}"


def get_expected_path(name: str) -> Path:
    return CORPUS / "expected" / f"{name}.txt"


def test_the_corpus_is_whole() -> None:
    assert len(LAUNCH_FILES) >= 30
    assert {path.name for path in (CORPUS / "expected").iterdir()} == {f"{name}.txt" for name in LAUNCH_FILES}


@pytest.mark.parametrize("name", LAUNCH_FILES)
def test_a_launch_file_becomes_tasks(name: str, tmp_path: Path) -> None:
    made = import_from_corpus(name)
    assert render_import(made) == get_expected_path(name).read_text()
    (tmp_path / "fleet.yaml").write_text(made.inventory)
    (tmp_path / "tasks.yaml").write_text(made.tasks)
    _, tasks, warnings = load_inventory_and_tasks(tmp_path / "fleet.yaml", [tmp_path / "tasks.yaml"])
    assert tasks.tasks
    # Where the file names no machine, this one stands for the edges: that robots do not reach it is said.
    assert all("127.0.0.1" in warning.message for warning in warnings)
    assert not warnings or "Write the edges of the lab instead" in made.inventory


def test_an_import_is_the_same_each_time() -> None:
    first, second = (import_from_corpus("robots.launch.py") for _ in range(2))
    assert first.tasks == second.tasks
    assert first.inventory.splitlines()[-1] == second.inventory.splitlines()[-1]


def test_a_password_of_a_machine_is_never_shown() -> None:
    made = import_from_corpus("machines.launch")
    assert "secret7" not in f"{made}"


if __name__ == "__main__":
    (CORPUS / "expected").mkdir(exist_ok=True)
    for each in LAUNCH_FILES:
        get_expected_path(each).write_text(render_import(import_from_corpus(each)))
