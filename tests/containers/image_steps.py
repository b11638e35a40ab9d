# SPDX-License-Identifier: Apache-2.0
"""The steps of .ci/Containerfile without an engine: its copies and its calls of pip, with an interpreter of this machine.

Its other steps (packages of the base image, the user) run in tests/containers/test_image.py, which builds the image.
"""

import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
CONTAINERFILE = ROOT / ".ci" / "Containerfile"
# They belong to the base image or to the machine.
_OTHER_STEPS = ("FROM", "ARG", "USER", "ENV", "WORKDIR", "ENTRYPOINT")
_FOLDERS = ("/src", "/wheels")


def list_instructions() -> Iterator[tuple[str, str]]:
    """Word and arguments of each instruction, with its lines joined."""
    lines = [line for line in CONTAINERFILE.read_text().splitlines() if line and not line.startswith("#")]
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        word, _, rest = line.partition(" ")
        yield word, rest.strip()


def install_as_image(python: Path, folder: Path) -> Path:
    """Do what the Containerfile does with ``python`` below ``folder``; the interpreter that has edgectl then.

    Raises:
        ValueError: the file has an instruction or a call of pip that is not known here.
    """
    subprocess.run([python, "-m", "venv", "--without-pip", folder / "image"], check=True)
    made = folder / "image" / "bin" / "python"
    calls = 0
    for word, rest in list_instructions():
        if word == "COPY":
            _copy(rest, folder)
        elif word == "RUN":
            for command in rest.split("&&"):
                calls += _run_pip(shlex.split(command), made, folder)
        elif word not in _OTHER_STEPS:
            raise ValueError(f"{CONTAINERFILE.name}: {word} is not known here")
    if calls != 2:
        raise ValueError(
            f"{CONTAINERFILE.name}: {calls} calls of pip, not one that builds and one that installs"
        )
    return made


def _locate(path: str, folder: Path) -> str:
    """The path below ``folder`` of one in the image; anything else as it is."""
    return f"{folder}{path}" if path.startswith(_FOLDERS) else path


def _copy(arguments: str, folder: Path) -> None:
    if arguments.startswith("--from="):
        return  # both stages are one folder
    *names, target = arguments.split()
    for name in names:
        source, there = ROOT / name, Path(_locate(target, folder))
        if source.is_dir():
            shutil.copytree(source, there, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            into = there / source.name if target.endswith("/") else there
            into.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, into)


def _run_pip(words: list[str], python: Path, folder: Path) -> bool:
    """Run a call of pip; False for a command that is none."""
    if words[:1] != ["pip"]:
        return False
    ours = [sys.executable, "-m", "pip", "--python", str(python), "--quiet", "--disable-pip-version-check"]
    given = [_locate(each, folder) for each in words[1:] if each != "--no-cache-dir"]
    spared = ["--no-compile"] if given[0] == "install" else []  # only what is used is compiled then
    subprocess.run([*ours, *given, *spared], check=True)
    return True
