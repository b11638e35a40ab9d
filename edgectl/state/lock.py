# SPDX-License-Identifier: Apache-2.0
"""Lock of a fleet: a kernel file lock that ends with its process and never needs removal."""

import fcntl
import getpass
import json
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

from edgectl.errors import LockBusyError
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.paths import open_private_file
from edgectl.units import format_instant

_POLL_S, _MAX_CYCLE_S = 0.1, 3600.0


class FleetLock:
    """Context manager around the lock file of one fleet. The file stays; only the kernel's lock counts.

    ``timeout`` (s, 0: do not wait; None: for one cycle of a watch, else not at all). The holder records its
    identity for the message of others, and a watch how long its cycle may take (``cycle_s``).
    """

    def __init__(
        self,
        fleet_dir: Path,
        *,
        verb: str = "apply",
        timeout: float | None = 0.0,
        clock: Callable[[], float] = time.time,
        name: str = "lock",
        cycle_s: float = 0.0,
    ) -> None:
        self._path = fleet_dir / name
        self._cycle_s = cycle_s
        self._verb = verb
        self._timeout = timeout
        self._clock = clock
        self._descriptor: int | None = None

    def __enter__(self) -> Self:
        """Take the lock.

        Raises:
            LockBusyError: another process holds it; the message names the process.
        """
        descriptor = open_private_file(self._path, os.O_RDWR)
        try:
            self._wait(descriptor)
            self._sign(descriptor)
            hit_failpoint("lock taken")
        except BaseException:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        return self

    def __exit__(self, *exc: object) -> None:
        if self._descriptor is not None:
            os.ftruncate(self._descriptor, 0)
            os.close(self._descriptor)
            self._descriptor = None
            hit_failpoint("lock released")

    def _wait(self, descriptor: int) -> None:
        began = time.monotonic()
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                timeout = _read_cycle_s(descriptor) if self._timeout is None else self._timeout
                if time.monotonic() - began >= timeout:
                    raise LockBusyError(
                        f"lock held by {_describe_holder(descriptor)}",
                        hint="wait for it, or pass --lock-timeout 60s",
                    ) from None
                time.sleep(_POLL_S)
            else:
                return

    def _sign(self, descriptor: int) -> None:
        holder = {
            "user": get_user_name(),
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "verb": self._verb,
            "since": format_instant(self._clock()),
        } | ({"cycle_s": self._cycle_s} if self._cycle_s else {})
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(holder).encode() + b"\n", 0)


def is_locked_elsewhere(fleet_dir: Path) -> bool:
    """Whether another process is changing the fleet now; never waits."""
    try:
        descriptor = os.open(fleet_dir / "lock", os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        signed = os.pread(descriptor, 4096, 0)
        # A file without a record is free. A record may be of a process that was killed: only the kernel
        # knows.
        if not signed or _decode_holder_pid(signed) == os.getpid():
            return False
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def get_user_name() -> str:
    """Name of the user who runs this command."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


def describe_manager() -> str:
    """User and machine of this command: ``ana@lab-pc``."""
    return f"{get_user_name()}@{socket.gethostname()}"


def _decode_holder_pid(signed: bytes) -> object:
    try:
        holder = json.loads(signed)
    except ValueError:
        return None
    return holder.get("pid") if isinstance(holder, dict) else None


def _read_cycle_s(descriptor: int) -> float:
    """How long the holder, a watch, may take for its cycle; 0 for any other holder."""
    try:
        return min(_MAX_CYCLE_S, float(json.loads(os.pread(descriptor, 4096, 0))["cycle_s"]))
    except (ValueError, KeyError, TypeError):
        return 0.0


def _describe_holder(descriptor: int) -> str:
    try:
        holder = json.loads(os.pread(descriptor, 4096, 0))
        return (
            f"{holder['user']}@{holder['host']} (pid {holder['pid']}, {holder['verb']}, since "
            f"{holder['since']})"
        )
    except (ValueError, KeyError, TypeError):
        return "another edgectl"
