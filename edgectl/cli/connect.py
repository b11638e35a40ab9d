# SPDX-License-Identifier: Apache-2.0
"""Construction of a fleet from its files."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edgectl.cli import console
from edgectl.cli.user_files import LoadedInputs, refuse_exposed_files
from edgectl.errors import UsageError
from edgectl.units import QuantityError, parse_duration
from edgectl.usecases.fleet import Fleet, show_nothing

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from edgectl.gateway.host_probe import HostCallback
    from edgectl.model.diagnosis import Disk


def build_fleet(loaded: LoadedInputs, *, accept_new: bool = False, asking: bool = True) -> Fleet:
    """The fleet with a transport and its state directory. Nothing is contacted yet.

    ``asking``: passwords may be asked for at the terminal.

    Raises:
        InputError: others may write the files.
    """
    from edgectl.state.fleet_dir import ensure_fleet_dir

    refuse_exposed_files(loaded.exposed)
    state = ensure_fleet_dir(loaded.inventory.fleet, loaded.path)
    return _build_fleet_with_state(loaded, state, accept_new=accept_new, asking=asking)


def _build_fleet_with_state(
    loaded: LoadedInputs, state: Path, *, accept_new: bool = False, asking: bool = True
) -> Fleet:
    from edgectl.usecases.open_fleet import open_fleet

    refuse_exposed_files(loaded.exposed)
    return open_fleet(
        loaded.inventory,
        loaded.tasks,
        state,
        warn=print_warning,
        accept_new=accept_new,
        ask_password=_ask_password if asking and _is_attended() else None,
        show_probe=_show_wait if asking and sys.stderr.isatty() else show_nothing,
    )


def build_fleet_with_state_check(loaded: LoadedInputs) -> "tuple[Fleet, Disk]":
    """The fleet, even if its state directory is unusable, and the condition of that directory."""
    from edgectl.state.state_dir_check import inspect_state_dir

    state = inspect_state_dir(loaded.inventory.fleet, loaded.path)
    return (
        build_fleet(loaded) if not state.obstacle else _build_fleet_with_state(loaded, Path(state.path))
    ), state


def build_offline_fleet(loaded: LoadedInputs) -> Fleet:
    """The fleet for decisions from a file: no host is contacted and no state is read."""
    from edgectl.transport.fake import FakeTransport

    return Fleet(inventory=loaded.inventory, tasks=loaded.tasks, transport=FakeTransport({}), state=Path())


def _is_attended() -> bool:
    """Whether somebody sits at the terminal that is stdin."""
    if not sys.stdin.isatty():
        return False
    from edgectl.views.text import is_ci

    return not is_ci()


def _show_wait(hosts: Sequence[str]) -> "AbstractContextManager[HostCallback | None]":
    from edgectl.views.wait_line import show_wait

    return show_wait(hosts)


def _ask_password(prompt: str) -> str:
    from getpass import getpass

    from edgectl.views.wait_line import pause_wait

    with pause_wait():
        return getpass(prompt)


def print_warning(message: str) -> None:
    """Print a warning that does not stop the call."""
    console.print_message(f"warning: {message}")


def parse_lock_timeout(text: str | None) -> float | None:
    """Parse ``--lock-timeout``; None: one cycle of a watch.

    Raises:
        UsageError: it is not a duration.
    """
    return None if text is None else parse_duration_option(text, "--lock-timeout")


def parse_duration_option(text: str, option: str) -> float:
    """Parse a duration given to an option.

    Raises:
        UsageError: it is not a duration.
    """
    try:
        return parse_duration(float(text) if text.replace(".", "", 1).isdigit() else text)
    except QuantityError as error:
        raise UsageError(f"{option} {error.message}", hint=error.hint) from None
