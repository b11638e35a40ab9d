# SPDX-License-Identifier: Apache-2.0
"""Imports of other tools' files: launch files, host lists, the paper's requirements."""

import glob
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.source import read_source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.errors import InputError, Problem, UsageError
from edgectl.importers.ansible_inventory import read_ansible_hosts
from edgectl.importers.compose_file import build_compose_tasks
from edgectl.importers.host_lists import ImportedHost, build_inventory
from edgectl.importers.launch_group import add_launch_file
from edgectl.importers.launch_values import Launch, Workspace
from edgectl.importers.paper_tasks import build_paper_files
from edgectl.importers.python_launch import add_python_launch
from edgectl.importers.ros1_launch import read_ros1_launch
from edgectl.importers.ros2_launch import read_ros2_launch
from edgectl.importers.ros_tasks import build_files, to_host_name
from edgectl.importers.ssh_hosts import list_host_aliases, select_aliases
from edgectl.importers.yaml_text import render_file
from edgectl.transport.ssh_config import CONFIG_OVERRIDE_VARIABLE, SYSTEM_CONFIG, get_home_dir
from edgectl.usecases.import_result import Imported, finish_import, name_fleet
from edgectl.usecases.launch_program import run_launch_program, show_given_path
from edgectl.usecases.ros_packages import PackageIndex

RefuseExposed: TypeAlias = Callable[[Sequence[Problem]], None]
_ROS1_NODE = re.compile(r"<(?:node|test)\b[^<>]*?\stype\s*=")
_ROS2_NODE = re.compile(
    r"<(?:node|executable|node_container|let|push[_-]ros[_-]namespace)\b[^<>]*?\s(?:exec|cmd|value|namespace)\s*="
)
_PASSWORD = re.compile(r"""(\b\w*pass(?:word)?\w*\s*[=:]\s*)("[^"]*"|'[^']*'|[^\s,}]+)""")


def import_ros(
    paths: Sequence[str],
    arguments: Mapping[str, str],
    package_path: Sequence[str],
    *,
    by_file: bool,
    refuse_exposed: RefuseExposed,
) -> Imported:
    """Make tasks and an inventory of launch files. ``by_file``: one task per file instead of one per node.

    ``refuse_exposed`` raises for warnings about programs that others may write.

    Raises:
        InputError: everything that is wrong with the files.
    """
    launch = read_launch_files(paths, arguments, package_path, by_file=by_file, refuse_exposed=refuse_exposed)
    name = to_host_name(Path(paths[0]).name.partition(".")[0])
    made = build_files(launch, ", ".join(Path(path).name for path in paths), name_fleet(name))
    return finish_import(name, render_file(made.inventory), render_file(made.tasks), launch.notes)


def read_launch_files(
    paths: Sequence[str],
    arguments: Mapping[str, str],
    package_path: Sequence[str],
    *,
    by_file: bool,
    refuse_exposed: RefuseExposed,
) -> Launch:
    """What launch files start, with at least one node.

    Raises:
        InputError: everything that is wrong with the files.
    """
    launch = Launch(problems=Problems())
    packages = PackageIndex(package_path)
    workspace = Workspace(
        read=_read_file, find_package=packages.find, find_owner=packages.find_owner, env=dict(os.environ)
    )
    for path in paths:
        if by_file:
            _add_whole_file(path, arguments, packages, launch)
        elif path.endswith(".py"):
            _refuse_exposed_program(path, refuse_exposed)
            _run_python(path, arguments, packages, workspace, launch)
        elif _detect_version(path) == 1:
            read_ros1_launch(path, arguments, workspace, launch)
        else:
            read_ros2_launch(path, arguments, workspace, launch)
    if not launch.nodes and not launch.problems.errors:
        nowhere = Mark(Source(file=paths[0], text="", lines=()), 1, 1)
        launch.problems.add(
            nowhere,
            ProblemCode.EMPTY,
            "the file starts nothing",
            "check the conditions and args of its nodes",
        )
    if launch.problems.errors:  # what was dropped may be the cause
        raise InputError((*launch.problems.errors, *launch.notes))
    return launch


def import_paper(path: str) -> Imported:
    """Make tasks and an inventory of the requirement file of the paper's authors.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    launch = Launch(problems=problems)
    source = _read_file(path, problems)
    root = parse_yaml(source, problems) if source is not None else None
    problems.check()
    name = to_host_name(Path(path).name.partition(".")[0])
    made = (
        build_paper_files(root, Path(path).name, name_fleet(name), problems, launch)
        if root is not None
        else None
    )
    problems.check()
    if made is None:
        raise UsageError(f"{path} is empty")
    return finish_import(name, render_file(made.inventory), render_file(made.tasks), launch.notes)


def import_compose(path: str) -> Imported:
    """Make tasks of the services of a compose file, and an inventory of this machine.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    launch = Launch(problems=problems)
    source = _read_file(path, problems)
    root = parse_yaml(source, problems, merge_keys=True) if source is not None else None
    problems.check()
    name = to_host_name(Path(path).name.partition(".")[0])
    if root is None:
        raise UsageError(f"{path} is empty")
    made = build_compose_tasks(root, Path(path).name, name_fleet(name), os.environ, problems, launch)
    problems.check()
    return finish_import(name, render_file(made.inventory), render_file(made.tasks), launch.notes)


def import_ansible(path: str) -> Imported:
    """Make an inventory from an Ansible inventory, in INI or YAML. Scripts are not run.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    launch = Launch(problems=problems)
    source = _read_file(path, problems)
    if source is not None and source.text.startswith("#!"):
        hint = f"save its output: {path} --list, converted to YAML by ansible-inventory --yaml --list"
        problems.add(Mark(source, 1, 1), ProblemCode.SYNTAX, "this is a script, which is not run", hint)
        source = None
    hosts = read_ansible_hosts(source, problems, launch) if source is not None else []
    problems.check()
    return _finish_hosts(
        hosts, Path(path).name, to_host_name(Path(path).name.partition(".")[0]), launch.notes
    )


def import_ssh(patterns: Sequence[str]) -> Imported:
    """Make an inventory of the aliases in the user's ssh_config that a pattern matches.

    The inventory names the alias alone: what ssh_config says of it stays there, and counts.

    Raises:
        UsageError: a pattern matches none.
    """
    aliases = list_ssh_aliases()
    for pattern in patterns:
        if not select_aliases(aliases, [pattern]):
            known = f"its hosts: {', '.join(aliases[:12])}" if aliases else "it defines no host"
            raise UsageError(f"no host of the ssh_config matches {pattern!r}", hint=known)
    hosts = [ImportedHost(name=alias, address=alias) for alias in select_aliases(aliases, list(patterns))]
    return _finish_hosts(hosts, "the ssh_config", "ssh", [])


def list_ssh_aliases() -> list[str]:
    """The aliases without wildcards of the files that ssh reads, with those that they include."""
    override = os.environ.get(CONFIG_OVERRIDE_VARIABLE)
    own = Path(get_home_dir()) / ".ssh"
    roots = (
        [(Path(override), own)]
        if override
        else [(own / "config", own), (SYSTEM_CONFIG, SYSTEM_CONFIG.parent)]
    )

    def read(path: str) -> str:
        try:
            return Path(path).read_text(errors="replace")
        except OSError:
            return ""

    def expander(base: Path) -> Callable[[str], list[str]]:
        def expand(pattern: str) -> list[str]:
            return sorted(glob.glob(str(base / Path(pattern).expanduser())))  # noqa: PTH207 - the pattern may be absolute

        return expand

    return list(
        dict.fromkeys(
            alias for path, base in roots for alias in list_host_aliases(str(path), read, expander(base))
        )
    )


def _finish_hosts(hosts: Sequence[ImportedHost], title: str, name: str, notes: Sequence[Problem]) -> Imported:
    return finish_import(name, render_file(build_inventory(hosts, title, name_fleet(name))), "", notes)


def _read_file(path: str, problems: Problems) -> Source | None:
    """The text of a file; passwords are hidden in the lines that messages show."""
    source = read_source(Path(path), problems, maker="")
    if source is None or "pass" not in source.text.lower():
        return source
    return replace(source, lines=tuple(_hide_passwords(line) for line in source.lines))


def _hide_passwords(line: str) -> str:
    return _PASSWORD.sub(lambda found: found[1] + "*" * len(found[2]), line)


def _detect_version(path: str) -> int:
    """The generation of ROS: by what the file holds, else by its name."""
    if path.endswith((".yaml", ".yml")):
        return 2
    try:
        text = Path(path).read_text(errors="replace")
    except OSError:
        text = ""
    if bool(_ROS1_NODE.search(text)) != bool(_ROS2_NODE.search(text)):
        return 1 if _ROS1_NODE.search(text) else 2
    return 2 if path.endswith(".launch.xml") else 1


def _add_whole_file(path: str, arguments: Mapping[str, str], packages: PackageIndex, launch: Launch) -> None:
    if _read_file(path, launch.problems) is not None:
        version = 2 if path.endswith(".py") else _detect_version(path)
        owner = packages.find_owner(path)
        place = str(Path(path).absolute())
        add_launch_file(place, version, owner[0] if owner else "", arguments, launch)


def _refuse_exposed_program(path: str, refuse_exposed: RefuseExposed) -> None:
    problems = Problems()
    _read_file(path, problems)
    refuse_exposed([each for each in problems.warnings if each.code == ProblemCode.EXPOSED])


def _run_python(
    path: str, arguments: Mapping[str, str], packages: PackageIndex, workspace: Workspace, launch: Launch
) -> None:
    """Evaluate a ``.launch.py`` in a child process with bounded time and memory."""
    if _read_file(path, launch.problems) is None:
        return
    packages.find_owner(path)
    full = str(Path(path).absolute())
    record = run_launch_program(full, arguments, packages.directories)
    shown = show_given_path(record, full, path)
    add_python_launch(shown, path, arguments, workspace, packages.directories, launch)
