# SPDX-License-Identifier: Apache-2.0
"""Modules are taken from one file, and never another one than Python would import."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# Imports the modules that are named; prints VALUE of each, and which came from the file.
PROGRAM = """
import sys
from edgectl.module_cache import ModuleCache
cache = ModuleCache(sys.argv[1])
sys.meta_path.insert(0, cache)
found = []
for name in sys.argv[2:]:
    __import__(name)
    module = sys.modules[name]
    found.append(f"{module.VALUE}{'*' if module.__spec__.cached == sys.argv[1] else ''}")
cache.update()
print(*found)
"""


class Project:
    """Modules in directories of their own, and a file for their code."""

    def __init__(self, folder: Path) -> None:
        self.file, self.first, self.second = folder / "all.pyc", folder / "first", folder / "second"
        for each in (self.first, self.second):
            # Python makes this one at the first import, and the directory has changed by it.
            (each / "__pycache__").mkdir(parents=True)
        self.write("second/single.py", 1)
        self.write("second/package/__init__.py", 2)
        self.write("second/package/inner.py", 3)

    def write(self, name: str, value: int) -> None:
        path = self.first.parent / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"VALUE = {value}\n")
        # Times of two versions differ, however quickly they were written.
        os.utime(path, ns=(0, value * 10**9))

    def run(self, *names: str, **environment: str) -> str:
        """Import modules in a new process."""
        names = names or ("single", "package", "package.inner")
        env = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        env["PYTHONPATH"] = f"{self.first}:{self.second}:{Path(__file__).parents[1]}"
        command = [sys.executable, "-c", PROGRAM, str(self.file), *names]
        done = subprocess.run(
            command, env=env | environment, cwd=self.first.parent, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


@pytest.fixture
def project(tmp_path: Path) -> Iterator[Project]:
    made = Project(tmp_path)
    assert made.run() == "1 2 3"
    assert made.run() == "1* 2* 3*"
    yield made
    # Nothing is left of an unfinished file.
    assert [path.name for path in tmp_path.glob("all*")] == ["all.pyc"]


def test_a_module_that_was_not_imported_before_joins_the_others(project: Project) -> None:
    project.write("second/other.py", 4)
    assert project.run("other") == "4"
    # It came into the directory of the first one, which might have changed by it.
    assert project.run("other", "single", "package.inner") == "4* 1 3*"
    assert project.run("other", "single", "package.inner") == "4* 1* 3*"


def test_a_changed_source_is_imported(project: Project) -> None:
    project.write("second/package/inner.py", 7)
    assert project.run() == "1* 2* 7"
    assert project.run() == "1* 2* 7*"


def test_a_source_of_the_same_time_and_another_size_is_imported(project: Project) -> None:
    place = project.second / "single.py"
    place.write_text("VALUE = 10\n")
    os.utime(place, ns=(0, 10**9))
    assert project.run("single") == "10"


def test_another_source_of_the_same_time_and_size_is_imported(project: Project) -> None:
    """An upgrade removes Python's files of code with its sources, and archives may state one time for all files."""
    place = project.second / "package" / "inner.py"
    place.write_text("VALUE = 9\n")
    os.utime(place, ns=(0, 3 * 10**9))
    for code in place.parent.glob("__pycache__/inner.*"):
        code.unlink()
    assert project.run() == "1* 2* 9"


def test_a_removed_source_is_not_imported(project: Project) -> None:
    (project.second / "package" / "inner.py").unlink()
    with pytest.raises(AssertionError, match=r"No module named 'package\.inner'"):
        project.run()
    assert project.run("single", "package") == "1* 2*"


@pytest.mark.parametrize("name", ["single.py", "single/__init__.py"])
def test_a_module_of_an_earlier_directory_goes_first(project: Project, name: str) -> None:
    """Also after it is gone again, and a module of another name has no part in it."""
    project.write(f"first/{name}", 8)
    assert project.run() == "8 2* 3*"
    assert project.run() == "8* 2* 3*"
    project.run("package")
    (project.first / name).unlink()
    assert project.run() == "1 2* 3*"
    assert project.run() == "1* 2* 3*"


def test_a_module_of_a_directory_that_was_not_searched_then_goes_first(project: Project) -> None:
    root, third = Path(__file__).parents[1], project.first.parent / "third"
    third.mkdir()
    (third / "single.py").write_text("VALUE = 9\n")
    assert project.run(PYTHONPATH=f"{third}:{project.second}:{root}") == "9 2* 3*"
    # That run has written the file for its own directories; the others are found as before.
    assert project.run() == "1 2* 3*"
    assert project.run() == "1* 2* 3*"


def test_the_order_of_directories_decides(project: Project) -> None:
    project.write("first/single.py", 8)
    assert project.run("single") == "8"
    root = Path(__file__).parents[1]
    assert project.run("single", PYTHONPATH=f"{project.second}:{project.first}:{root}") == "1"
    assert project.run("single") == "8"


def test_modules_of_the_working_directory_go_first(project: Project) -> None:
    """``python -c`` has the empty name on ``sys.path``, for whatever directory that is."""
    (project.first.parent / "single.py").write_text("VALUE = 6\n")
    assert project.run("single") == "6"
    (project.first.parent / "single.py").unlink()
    assert project.run("single") == "1"


def test_a_path_that_a_module_adds_decides(project: Project) -> None:
    project.write("first/single.py", 8)
    (project.second / "adds.py").write_text(
        f"import sys\nsys.path.insert(0, {str(project.first)!r})\nVALUE = 0\n"
    )
    path = f"{project.second}:{Path(__file__).parents[1]}"
    assert project.run("single", "adds", PYTHONPATH=path) == "1 0"
    assert project.run("adds", "single", PYTHONPATH=path) == "0* 8"


def test_a_file_that_was_cut_off_anywhere_does_no_harm(project: Project) -> None:
    whole = project.file.read_bytes()
    for length in {*range(0, len(whole), 97), 1, 7, 8, 9, len(whole) - 1}:
        project.file.write_bytes(whole[:length])
        assert project.run(PYTHONDONTWRITEBYTECODE="1").replace("*", "") == "1 2 3", length
        assert len(project.file.read_bytes()) == length
    project.run()
    assert project.run() == "1* 2* 3*"


@pytest.mark.parametrize(
    "content", [b"", bytes(1000), b"\xff" * 1000, b"no code", (3).to_bytes(8, "little") + b"N"]
)
def test_a_file_of_anything_else_is_written_again(project: Project, content: bytes) -> None:
    project.file.write_bytes(content)
    assert project.run() == "1 2 3"
    assert project.run() == "1* 2* 3*"


def test_a_file_of_another_python_is_written_again(project: Project) -> None:
    data = project.file.read_bytes()
    from importlib.util import MAGIC_NUMBER

    assert data.count(MAGIC_NUMBER) == 1
    project.file.write_bytes(data.replace(MAGIC_NUMBER, b"\0\0\r\n"))
    assert project.run() == "1 2 3"
    assert project.run() == "1* 2* 3*"


def test_nothing_is_written_where_that_is_not_possible_or_not_wanted(project: Project) -> None:
    project.file.unlink()
    assert project.run(PYTHONDONTWRITEBYTECODE="1") == "1 2 3"
    assert not project.file.exists()
    project.file.mkdir()
    assert project.run() == project.run() == "1 2 3"
    assert [path.name for path in project.file.parent.glob("all*")] == ["all.pyc"]
    project.file.rmdir()
    project.run()


def test_nothing_is_written_for_nothing_new(project: Project) -> None:
    before = project.file.stat().st_ino
    project.run("single")
    project.run()
    assert project.file.stat().st_ino == before


def test_what_a_module_finds_elsewhere_is_no_reason_to_write(project: Project) -> None:
    """As the modules of a plugin that is installed for its development, from whatever directory."""
    project.write("aside/far.py", 5)
    (project.second / "guide.py").write_text(
        f"import sys\nsys.path.append({str(project.first.parent / 'aside')!r})\nVALUE = 0\n"
    )
    names = ("guide", "far")
    assert [project.run(*names) for _ in range(3)] == ["0 5", "0* 5", "0* 5"]
    before = project.file.stat().st_ino
    (project.first.parent / "new").touch()
    assert project.run(*names) == "0* 5"
    assert project.file.stat().st_ino == before


def test_many_processes_that_write_at_once_leave_a_whole_file(project: Project) -> None:
    project.file.unlink()
    env = os.environ | {"PYTHONPATH": f"{project.first}:{project.second}:{Path(__file__).parents[1]}"}
    env.pop("PYTHONDONTWRITEBYTECODE", None)
    sets = (["single"], ["package"], ["package.inner", "package"], ["single", "package"])
    running = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(project.file), *names],
            env=env, cwd=project.first.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for names in sets * 3
    ]  # fmt: skip
    for each in running:
        _, errors = each.communicate(timeout=60)
        assert (each.returncode, errors) == (0, "")
    project.run()
    assert project.run() == "1* 2* 3*"


COUNTED = """
import sys
opened = []
sys.addaudithook(lambda event, args: opened.append(args[0]) if event == "open" and str(args[0]).endswith(".pyc") else None)
from edgectl.cli.main import run
try:
    run()
finally:
    print(len(opened), file=sys.stderr)
"""


@pytest.mark.parametrize("words", [["version"], ["validate", "--help"]])
def test_a_command_opens_one_file_of_code_instead_of_hundreds(tmp_path: Path, words: list[str]) -> None:
    """The others are of modules that are imported before it."""
    env = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    env |= {"PYTHONPYCACHEPREFIX": str(tmp_path), "EDGECTL_STATE_DIR": str(tmp_path / "state")}
    runs = [
        subprocess.run(
            [sys.executable, "-c", COUNTED, *words], env=env, capture_output=True, text=True, check=False
        )
        for _ in range(2)
    ]
    assert runs[0].stdout == runs[1].stdout
    assert [each.returncode for each in runs] == [0, 0]
    first, second = (int(each.stderr.split()[-1]) for each in runs)
    assert first > 150
    assert second < 60
