# SPDX-License-Identifier: Apache-2.0
"""Calls of a container engine: its program with an argument vector, bounded in time, without a shell."""

import os
import time

from ..link import fast_json
from ..link.errors import RefusalError
from ..link.fast_json import Document

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping, Sequence

ENGINES = ("docker", "podman")
# docker's own program runs services of a swarm.
SWARM = "swarm"
NO_ENGINE = "no-container-engine"
# What a call came to; LOST: the engine did not answer, so nothing is known.
DONE, FAILED, GONE, LOST = "done", "failed", "gone", "lost"
CALL_S, _VERSION_S = 10.0, 4.0
_MAX_WORDS = 300
_DOCKER_HOST = "unix:///var/run/docker.sock"
_LOST_WORDS = (
    "cannot connect to the docker daemon",
    "connection refused",
    "error during connect",
    "unexpected eof",
)
_GONE_WORDS = (
    *("no such container", "no such object", "no such service"),
    *("is not running", "already in progress"),
)
# HUP, USR1, USR2, CONT, STOP, TSTP, WINCH: what programs are told other things by.
_OTHER_SIGNALS = frozenset(("1", "10", "12", "18", "19", "20", "28"))
_FOLDERS = ("/usr/bin", "/usr/local/bin", "/bin", "/snap/bin")


class EngineCall:
    """The end of one call: ``kind`` as above, ``out`` its output, ``why`` the last line of its errors."""

    __slots__ = ("kind", "out", "refused", "why")

    def __init__(self, kind: str, out: str, why: str, refused: bool = False) -> None:
        """``refused``: nothing listens; an engine that only hangs may still act on what it was asked."""
        self.kind, self.out, self.why, self.refused = kind, out, why, refused


def find_program(engine: str) -> str:
    """Find the program of an engine; empty where this host has none."""
    folders = [folder for folder in os.environ.get("PATH", "").split(":") if folder.startswith("/")]
    paths = [os.path.join(folder, engine) for folder in [*folders, *_FOLDERS]]
    return next((path for path in paths if os.access(path, os.X_OK)), "")


def list_usable_engines(*, swarm: bool) -> "list[str]":
    """List the engines that this host has and this user may use. None is asked: that takes 50 ms of CPU.

    ``swarm``: docker is asked whether it is a node of a swarm, which then is an engine, too.
    """
    found = [name for name in ENGINES if find_program(name) and (name != "docker" or _may_use_docker())]
    if swarm and "docker" in found:
        call = call_engine(
            [find_program("docker"), "info", "--format", "{{.Swarm.LocalNodeState}}"], _VERSION_S
        )
        found += [SWARM] if call.out.strip() == "active" else []
    return found


def describe_engines() -> "dict[str, Document]":
    """Ask each engine that is installed for its version: ``version``, or the ``error`` for which it runs
    nothing.
    """
    found: "dict[str, Document]" = {}
    for name, form in (("docker", "{{.Server.Version}}"), ("podman", "{{.Client.Version}}")):
        program = find_program(name)
        if program:
            call = call_engine([program, "version", "--format", form], _VERSION_S)
            known = call.kind == DONE and call.out.strip()
            found[name] = {"version": call.out.strip()} if known else {"error": call.why or "no version"}
    return found


def _may_use_docker() -> bool:
    """Whether the socket of docker is there and may be used; an engine elsewhere is taken as usable."""
    stated = os.environ.get("DOCKER_HOST") or _DOCKER_HOST
    scheme, _, path = stated.partition("://")
    return scheme != "unix" or os.access(path, os.R_OK | os.W_OK)


def choose_program(wanted: "str | None") -> str:
    """Choose the engine that the spec names, else the first that this host has.

    Raises:
        RefusalError: there is none.
    """
    name = "docker" if wanted == SWARM else wanted
    found = [path for path in (find_program(each) for each in ([name] if name else ENGINES)) if path]
    if found:
        return found[0]
    what = "%s is not installed" % name if name else "neither docker nor podman is installed"
    raise RefusalError(NO_ENGINE, what, "install a container engine there, or allow other hosts")


def call_engine(
    argv: "Sequence[str]",
    timeout_s: float = CALL_S,
    env: "Mapping[str, str] | None" = None,
    keep: "tuple[int, ...]" = (),
) -> EngineCall:
    """Run ``argv`` for at most ``timeout_s`` seconds; it inherits the files ``keep``."""
    # Imported on demand: 2 MB in every process without a container.
    import subprocess

    try:
        process = subprocess.Popen(
            list(argv),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=None if env is None else dict(env),
            cwd="/",
            pass_fds=keep,
            start_new_session=True,
        )
    except OSError as error:
        return EngineCall(FAILED, "", "%s: %s" % (argv[0], error.strerror))
    try:
        out, errors = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return EngineCall(LOST, "", "%s did not answer within %g s" % (os.path.basename(argv[0]), timeout_s))
    return _judge_end(process.returncode, out, errors.decode("utf-8", "replace"))


def _judge_end(code: int, out: bytes, errors: str) -> EngineCall:
    text, lines = out.decode("utf-8", "replace"), [line for line in errors.splitlines() if line.strip()]
    if code == 0:
        return EngineCall(DONE, text, "")
    why = lines[-1].strip()[:_MAX_WORDS] if lines else "exit code %d" % code
    # After an error docker prints a line on --help.
    if len(lines) > 1 and "--help" in why:
        why = lines[-2].strip()[:_MAX_WORDS]
    known = errors.lower()
    if any(words in known for words in _LOST_WORDS):
        return EngineCall(LOST, text, why, refused="connect" in known)
    return EngineCall(GONE if any(words in known for words in _GONE_WORDS) else FAILED, text, why)


def inspect_state(program: str, container_id: str) -> "tuple[EngineCall, Document]":
    """Ask for the state of a container: the call, and what the engine has of it."""
    argv = [program, "inspect", "--type", "container", "--format", "{{json .State}}", container_id]
    call = call_engine(argv)
    if call.kind != DONE:
        return call, {}
    try:
        return call, dict(fast_json.loads(call.out.strip()))
    except ValueError:
        return EngineCall(FAILED, "", "the state of the container cannot be read"), {}


def was_told_to_end(program: str, container_id: str) -> bool:
    """Whether docker has told the container to end, for itself or for somebody, as far as it remembers: 256
    events at most, since it was started. podman has no engine that ends anything.
    """
    if os.path.basename(program) != "docker":
        return False
    argv = [program, "events", "--since", "1", "--until", "%.9f" % time.time()]
    argv += ["--filter", "container=" + container_id, "--filter", "event=kill"]
    call = call_engine([*argv, "--format", "{{.Actor.Attributes.signal}}"])
    return bool(set(call.out.split()) - _OTHER_SIGNALS)
