"""What can go wrong on a way; see `relay`."""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """What a relay can do to the bytes."""

    PASS = "pass"
    DELAY = "delay"
    BLACK_HOLE = "black-hole"
    CUT_FIN = "cut-fin"
    CUT_RST = "cut-rst"
    GARBLE = "garble"
    MUTE = "mute"
    REFUSE = "refuse"


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """``after``: bytes that pass unharmed; ``seconds``: of a delay, each way; ``lasting``: a cut also refuses what comes later;
    ``half_open``: what a black hole has harmed is never reset on the host's side, as when a router forgets a connection."""

    kind: Kind = Kind.PASS
    after: int = 0
    seconds: float = 0.0
    lasting: bool = False
    half_open: bool = False
