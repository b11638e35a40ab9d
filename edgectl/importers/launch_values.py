# SPDX-License-Identifier: Apache-2.0
"""Content of a launch file, independent of its generation and form: nodes, machines, parameters, notes."""

import posixpath
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.errors import Problem
from edgectl.importers.fault import ImportFaultError

MAX_INCLUDES = 500
MAX_INCLUDE_DEPTH = 30
# Directory of a package on the host, which may be another one there: \ue000KIND:PACKAGE\ue001.
PACKAGE_MARK = re.compile("\ue000(share|prefix):([A-Za-z0-9_.-]+)\ue001")
_PACKAGE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Workspace:
    """Files of this machine that launch files refer to.

    ``read`` gives a file's text, or None with the cause collected; ``find_package`` the directory of a
    package, if it is here; ``find_owner`` the package that holds a file, and its path in there;
    ``env`` the environment for ``$(env ..)``.
    """

    read: Callable[[str, Problems], Source | None]
    find_package: Callable[[str], str | None]
    find_owner: Callable[[str], tuple[str, str] | None]
    env: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A ``<machine>`` of ROS 1. ``port``: 0 is the default of SSH."""

    name: str
    address: str
    user: str = ""
    port: int = 0
    default: bool = False
    mark: Mark


@dataclass(slots=True, kw_only=True)
class RosNode:
    """One process that a launch file starts.

    ``version``: 1 or 2, the generation of ROS. ``package`` is empty for a plain program, which ``executable``
    names. ``parameters`` are the node's private ones; ``parameter_files`` are (file on the host, namespace).
    ``respawn`` is None where the file does not say. ``computed``: private parameters that the output of
    a command on the host gives. ``order`` counts the nodes; ``needs`` holds (order, state).
    """

    version: int
    mark: Mark
    package: str
    executable: str
    name: str
    namespace: str = "/"
    arguments: tuple[str, ...] = ()
    ros_arguments: tuple[str, ...] = ()
    remaps: tuple[tuple[str, str], ...] = ()
    parameters: dict[str, object] = field(default_factory=dict)
    parameter_files: tuple[tuple[str, str], ...] = ()
    env: dict[str, str] = field(default_factory=dict)
    machine: str = ""
    respawn: bool | None = None
    prefix: str = ""
    workdir: str = ""
    computed: dict[str, tuple[str, ...]] = field(default_factory=dict)
    needs: tuple[tuple[int, str], ...] = ()
    order: int = 0

    @property
    def full_name(self) -> str:
        """The name in the graph: ``/robot1/slam``."""
        return join_names(self.namespace, self.name)


@dataclass(slots=True, kw_only=True)
class Launch:
    """Everything read from launch files so far.

    ``parameters``: global ones by full name; ``computed``: those whose value is the output of a command.
    """

    problems: Problems
    nodes: list[RosNode] = field(default_factory=list)
    machines: dict[str, Machine] = field(default_factory=dict)
    parameters: dict[str, object] = field(default_factory=dict)
    computed: dict[str, tuple[str, ...]] = field(default_factory=dict)
    notes: list[Problem] = field(default_factory=list)
    includes: int = 0

    def add_node(self, node: RosNode) -> None:
        """Add a node after those before it."""
        node.order = len(self.nodes)
        self.nodes.append(node)

    def note(self, mark: Mark, message: str, hint: str = "") -> None:
        """Say that something of the file is not imported as it stands."""
        note = Problem(
            file=mark.source.file,
            line=mark.line,
            column=mark.column,
            code=ProblemCode.NOT_IMPORTED.value,
            message=message,
            hint=hint,
            warning=True,
        )
        if note not in self.notes:
            self.notes.append(note)


def join_names(namespace: str, name: str) -> str:
    """``name`` in ``namespace``; a name that begins with / is global."""
    if name.startswith("/"):
        return "/" + name.strip("/")
    return "/" + "/".join(part for part in (namespace.strip("/"), name.strip("/")) if part)


def mark_package(package: str, mark: Mark, kind: str = "share") -> str:
    """Text that stands for the directory of a package, wherever that is on the host.

    Raises:
        ImportFaultError: it is no name of a package.
    """
    if not _PACKAGE_NAME.fullmatch(package):
        message = f"{package!r} is no name of a package"
        raise ImportFaultError(mark, ProblemCode.SUBSTITUTION, message, "write one name: $(find PACKAGE)")
    return f"\ue000{kind}:{package}\ue001"


def mark_directory(file: str, workspace: Workspace) -> str:
    """The directory of a file: of its package on the host if a package holds it, else the one here."""
    owner = workspace.find_owner(file)
    if owner is None:
        return posixpath.dirname(file) or "."
    package, inside = owner
    return posixpath.join(f"\ue000share:{package}\ue001", posixpath.dirname(inside)).rstrip("/")


def expand_packages(text: str, workspace: Workspace, mark: Mark) -> str:
    """``text`` with the directories of packages on this machine.

    Raises:
        ImportFaultError: a package is not here.
    """

    def find(found: re.Match[str]) -> str:
        directory = workspace.find_package(found[2])
        if directory is None:
            raise ImportFaultError(
                mark,
                ProblemCode.INCLUDE,
                f"the package {found[2]} is not on this machine",
                "name the directory of its workspace: --package-path DIR",
            )
        return directory

    return PACKAGE_MARK.sub(find, text)


def read_referred_file(path: str, workspace: Workspace, mark: Mark) -> Source:
    """The text of a file that a launch file names at ``mark``.

    Raises:
        ImportFaultError: it cannot be read.
    """
    problems = Problems()
    source = workspace.read(path, problems)
    if source is None:
        problem = problems.errors[0]
        raise ImportFaultError(mark, ProblemCode.INCLUDE, f"{path}: {problem.message}", problem.hint)
    return source


def has_unknown_package(text: str, workspace: Workspace) -> bool:
    """Whether a package in it is not on this machine."""
    return any(workspace.find_package(found[2]) is None for found in PACKAGE_MARK.finditer(text))
