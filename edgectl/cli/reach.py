"""From files to a fleet that a use case can work on."""

import sys
from pathlib import Path

from edgectl.cli import console
from edgectl.cli.inputs import Loaded
from edgectl.errors import UsageError
from edgectl.model.finding import Disk
from edgectl.units import parse_duration
from edgectl.usecases.fleet import Fleet


def reach(loaded: Loaded, *, accept_new: bool = False, asking: bool = True) -> Fleet:
    """The fleet with a way to its hosts and its state directory. Nothing is contacted yet.

    ``asking``: a person at the terminal may be asked for a password.
    """
    from edgectl.state.paths import fleet_dir

    return _fleet(loaded, fleet_dir(loaded.path), accept_new=accept_new, asking=asking)


def _fleet(loaded: Loaded, state: Path, *, accept_new: bool = False, asking: bool = True) -> Fleet:
    from edgectl.transport.choose import Transports

    transport = Transports(accept_new=accept_new, ask_password=_ask_password if asking and sys.stdin.isatty() else None)
    return Fleet(inventory=loaded.inventory, tasks=loaded.tasks, transport=transport, state=state, warn=warn)


def examined(loaded: Loaded) -> tuple[Fleet, Disk]:
    """The fleet, also where its state directory cannot be used, and that directory as it stands."""
    from edgectl.state.standing import standing

    state = standing(loaded.path)
    return (reach(loaded) if not state.obstacle else _fleet(loaded, Path(state.path))), state


def offline(loaded: Loaded) -> Fleet:
    """The fleet for decisions from a file: no host is reached and no state is read."""
    from edgectl.transport.fake import FakeTransport

    return Fleet(inventory=loaded.inventory, tasks=loaded.tasks, transport=FakeTransport({}), state=Path())


def _ask_password(prompt: str) -> str:
    from getpass import getpass

    return getpass(prompt)


def warn(message: str) -> None:
    """Say what a user should know although the call goes on."""
    console.tell(f"warning: {message}")


def seconds(text: str, option: str) -> float:
    """A duration given to an option.

    Raises:
        UsageError: it is none.
    """
    try:
        return parse_duration(float(text) if text.replace(".", "", 1).isdigit() else text)
    except ValueError as error:
        message, _, hint = str(error).partition("; ")
        raise UsageError(f"{option} {message}", hint=hint) from None
