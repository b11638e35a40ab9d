# SPDX-License-Identifier: Apache-2.0
"""Byte counters of the hosts."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import Document, without_none
from edgectl.model.byte_counters import ByteCounters, RobotCounter
from edgectl.units import format_bytes, format_rate
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_HEAD = head(
    "host", "counters", "robot", "rx_bytes", "tx_bytes", "tcp_bytes", "rx_bytes_per_s", "tx_bytes_per_s"
)


class ByteCountersView(ListView):
    """Per host and robot the bytes since the installation and the rates of one second."""

    kind = "byte-counter"
    formats = NAMED_FORMATS

    def __init__(self, hosts: Iterable[ByteCounters]) -> None:
        self._hosts = list(hosts)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per host and robot."""
        rows: list[Row] = [_HEAD]
        for value in self._hosts:
            rows += _render_host_rows(value)
        return render_columns(rows, look, right=range(3, len(_HEAD)))

    def items(self) -> Sequence[Document]:
        """The hosts as JSON types."""
        return [_encode_counters(value) for value in self._hosts]

    def warnings(self) -> Sequence[str]:
        """What is missing on single hosts."""
        return [f"{value.host}: {note}" for value in self._hosts for note in _list_notes(value)]

    def names(self) -> Sequence[str]:
        """The hosts that have counters, as edge/HOST."""
        return [f"edge/{value.host}" for value in self._hosts if value.installed]


def _render_host_rows(value: ByteCounters) -> list[Row]:
    state = Cell(_describe_state(value), "good" if value.installed else "dim")
    if not value.robots:
        return [(Cell(value.host, "name"), state, *("-",) * (len(_HEAD) - 2))]
    return [
        (
            Cell(value.host, "name"),
            state,
            robot,
            *(format_bytes(amount) for amount in (each.rx_bytes, each.tx_bytes, each.tcp_bytes)),
            *(format_rate(rate) for rate in (each.rx_bytes_per_s, each.tx_bytes_per_s)),
        )
        for robot, each in value.robots.items()
    ]


def _describe_state(value: ByteCounters) -> str:
    if value.error:
        return "no answer"
    return value.state if value.installed or not value.state else "unreadable"


def _list_notes(value: ByteCounters) -> list[str]:
    if value.error:
        return [value.error + (f" ({value.hint})" if value.hint else "")]
    if value.state and not value.installed:
        return [f"{value.state} (edgectl counters install {value.host})"]
    if not value.state:
        return []
    gone = [robot for robot, each in value.robots.items() if not each.counted]
    notes = []
    if gone:
        notes.append(
            f"no counter for the present address of {', '.join(gone)} (edgectl counters install {value.host})"
        )
    if not value.tasks:
        notes.append("nft or the kernel is too old to count tasks (Linux 5.13, nft 0.9.9): robots only")
    return notes


def _encode_counters(value: ByteCounters) -> Document:
    return without_none(
        host=value.host,
        counters=value.state or None,
        tasks_counted=value.tasks if value.installed else None,
        robot_counters={name: _encode_robot(each) for name, each in value.robots.items()} or None,
        error=value.error or None,
        hint=value.hint or None,
    )


def _encode_robot(value: RobotCounter) -> Document:
    return {
        "addresses": list(value.addresses),
        "counted": value.counted,
        "rx_bytes": value.rx_bytes,
        "tx_bytes": value.tx_bytes,
        "tcp_bytes": value.tcp_bytes,
        "rx_bytes_per_s": value.rx_bytes_per_s,
        "tx_bytes_per_s": value.tx_bytes_per_s,
    }
