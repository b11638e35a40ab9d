# SPDX-License-Identifier: Apache-2.0
"""Link faults that a relay can inject; see `relay`."""

from dataclasses import dataclass
from enum import StrEnum


class LinkFaultKind(StrEnum):
    """Effect on the bytes of a connection. ``ANSWERS_LOST``, ``REQUESTS_LOST``: a black hole in one direction."""

    PASS = "pass"
    DELAY = "delay"
    BLACK_HOLE = "black-hole"
    CUT_FIN = "cut-fin"
    CUT_RST = "cut-rst"
    GARBLE = "garble"
    MUTE = "mute"
    REFUSE = "refuse"
    ANSWERS_LOST = "answers-lost"
    REQUESTS_LOST = "requests-lost"


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFault:
    """One fault of a link.

    ``after``: bytes that pass unharmed; ``seconds``: of a delay, each way; ``lasting``: later connections are
    refused, too; ``half_open``: connections harmed by a black hole are never reset on the host's side, as
    when a router forgets a connection.
    """

    kind: LinkFaultKind = LinkFaultKind.PASS
    after: int = 0
    seconds: float = 0.0
    lasting: bool = False
    half_open: bool = False
