"""Every exception that edgectl raises on purpose.

    EdgectlError                    anything reported to a user; carries a hint and an exit code
    ├── InputError                 one or more mistakes in a file, each with its position (exit 64)
    ├── UsageError                  a call that cannot be carried out as given (exit 64)
    ├── FileError                   a file that cannot be read or written (exit 1)
    ├── StateError                  the manager's own state is damaged or of a newer version (exit 1)
    ├── LockBusyError               another edgectl holds the lock or the fleet (exit 75)
    │   └── WatchedError            another watch looks after the fleet (exit 75)
    ├── CoordinationError           the etcd of the fleet does not answer, or no longer grants it (exit 75)
    ├── RosGraphError               the ROS master does not answer, or has forgotten us (exit 75)
    ├── StalePlanError              the fleet changed since the plan was made (exit 75)
    ├── UnansweredError             the answer depends on a host that did not answer (exit 4)
    ├── PluginError                 a plugin of another package cannot be loaded, or fails (exit 1)
    ├── FleetBusyError              the fleet is not free for an experiment (exit 75)
    └── HostError                   one host did not do what was asked; costs that host, never the run
        ├── ConnectError            no TCP or SSH session (off, refused, no route, name unknown)
        ├── HostKeyError            host key unknown, changed or revoked: nothing was sent
        ├── AuthError               the host knows us, but not this key or password
        ├── DeadlineError           connected, but no answer within the deadline
        ├── NoPythonError           the host has no usable python3
        ├── ReplyError              an answer that is not ours: noise, truncated, wrong digest or types
        └── RefusedError            the agent understood and declined (reason given)

Expected outcomes (unplaced, unreachable, deferred) are values, not exceptions.
"""

from collections.abc import Sequence
from enum import IntEnum

from edgectl.dataclass import dataclass


class ExitCode(IntEnum):
    """Exit status of the command (docs/cli.md, "Exit codes")."""

    DONE = 0
    FAILED = 1
    CHANGES = 2
    UNPLACED = 3
    PARTLY = 4
    USAGE = 64
    TRY_AGAIN = 75
    INTERRUPTED = 130


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One mistake in an input file, or a warning about something legal but suspicious.

    ``line`` and ``column`` count from 1; 0 refers to the file as a whole.
    ``source`` is the offending line as written, ``length`` the number of columns that the caret marks.
    ``code`` is stable ("EC012"); ``hint`` tells how to correct the mistake.
    """

    file: str
    line: int
    column: int
    code: str
    message: str
    hint: str = ""
    source: str = ""
    length: int = 1
    warning: bool = False


class EdgectlError(Exception):
    """Root of the exception tree: a one-line message, a hint with the remedy, and the exit code."""

    exit_code = ExitCode.FAILED

    def __init__(self, message: str, *, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class InputError(EdgectlError):
    """All mistakes found in the input files at once."""

    exit_code = ExitCode.USAGE

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__(_format_first_problem(problems))
        self.problems = tuple(problems)


def _format_first_problem(problems: Sequence[Problem]) -> str:
    """Message of the first problem with its position, and the number of the others."""
    if not problems:
        return "the input is wrong"
    first, more = problems[0], len(problems) - 1
    place = f"{first.file}:{first.line}:{first.column}" if first.line else first.file
    return f"{place}: {first.message}" + (f" (and {more} more)" if more else "")


class UsageError(EdgectlError):
    """The call cannot be carried out as given."""

    exit_code = ExitCode.USAGE


class FileError(EdgectlError):
    """A file cannot be read or written."""


class StateError(EdgectlError):
    """The manager's own state is damaged, or was written by a newer edgectl."""


class LockBusyError(EdgectlError):
    """Another edgectl is changing this fleet."""

    exit_code = ExitCode.TRY_AGAIN


class WatchedError(LockBusyError):
    """Another watch looks after this fleet; ``--take-over`` replaces it."""


class CoordinationError(EdgectlError):
    """The etcd that coordinates the managers of this fleet does not answer, or no longer grants the fleet."""

    exit_code = ExitCode.TRY_AGAIN


class RosGraphError(EdgectlError):
    """The master of the ROS graph does not answer, or was restarted."""

    exit_code = ExitCode.TRY_AGAIN


class StalePlanError(EdgectlError):
    """The saved plan no longer matches the fleet; ``changes`` lists the differences."""

    exit_code = ExitCode.TRY_AGAIN

    def __init__(self, changes: Sequence[str]) -> None:
        super().__init__(
            "saved plan is stale: " + "; ".join(changes), hint="make a new plan: edgectl plan --out PLAN"
        )
        self.changes = tuple(changes)


class UnansweredError(EdgectlError):
    """The answer depends on a host that did not answer."""

    exit_code = ExitCode.PARTLY


def describe_unseen_task(task: str, host: str) -> str:
    """Phrase for a task that no host reports, and whose last known ``host`` did not answer."""
    return f"{task}, last known on {host}, which does not answer"


class PluginError(EdgectlError):
    """A plugin cannot be loaded, or failed; the message names it and its package."""


class FleetBusyError(EdgectlError):
    """The fleet is not free for an experiment: tasks run on it, or a host does not answer."""

    exit_code = ExitCode.TRY_AGAIN


class HostError(EdgectlError):
    """Failure of one host. ``kind`` is its stable name in JSON."""

    kind = "failed"

    def __init__(self, message: str, *, hint: str = "", host: str = "") -> None:
        super().__init__(message, hint=hint)
        self.host = host


class ConnectError(HostError):
    """No session: the host is off, refuses connections, has no route or no known name."""

    kind = "connect"


class HostKeyError(HostError):
    """The host key is unknown, changed or revoked; nothing was sent."""

    kind = "host-key"


class AuthError(HostError):
    """The host refused every key (or the password) that was offered."""

    kind = "auth"


class DeadlineError(HostError):
    """Connected, but no answer in time."""

    kind = "deadline"


class NoPythonError(HostError):
    """The host has no python3 of at least version 3.6."""

    kind = "no-python"


class ReplyError(HostError):
    """The answer is not a valid agent reply."""

    kind = "bad-reply"


class RefusedError(HostError):
    """The agent understood the request and refused it."""

    kind = "refused"
