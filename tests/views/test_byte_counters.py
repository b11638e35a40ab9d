# SPDX-License-Identifier: Apache-2.0
"""Byte counters as a person and as a program sees them."""

import json

from edgectl.model.byte_counters import ByteCounters, RobotCounter
from edgectl.views.byte_counters import ByteCountersView
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat

SEEN = RobotCounter(
    addresses=("10.0.0.5",),
    counted=True,
    rx_bytes=5e6,
    tx_bytes=2e5,
    tcp_bytes=1e5,
    rx_bytes_per_s=1.2e6,
    tx_bytes_per_s=3e4,
)
FOUND = (
    ByteCounters(host="edge1", state="installed", tasks=True, robots={"robot1": SEEN}),
    ByteCounters(host="edge2", state="installed", robots={"robot1": RobotCounter(addresses=("10.0.0.6",))}),
    ByteCounters(host="edge3"),
    ByteCounters(host="edge4", state="nft is not installed"),
    ByteCounters(host="edge5", error="sudo asks for a password", hint="ssh -t edge5"),
)


def test_the_table_has_a_line_per_host_and_robot_and_notes_say_what_is_missing() -> None:
    lines = [line.split() for line in render_view(ByteCountersView(FOUND), OutputFormat.TABLE).splitlines()]
    assert lines[1] == ["edge1", "installed", "robot1", "4.8Mi", "195.3Ki", "97.7Ki", "1.2MB/s", "30.0kB/s"]
    assert [line[:3] for line in lines[2:6]] == [
        ["edge2", "installed", "robot1"],
        ["edge3", "-", "-"],
        ["edge4", "unreadable", "-"],
        ["edge5", "no", "answer"],
    ]
    notes = list(ByteCountersView(FOUND).warnings())
    assert notes == [
        "edge2: no counter for the present address of robot1 (edgectl counters install edge2)",
        "edge2: nft or the kernel is too old to count tasks (Linux 5.13, nft 0.9.9): robots only",
        "edge4: nft is not installed (edgectl counters install edge4)",
        "edge5: sudo asks for a password (ssh -t edge5)",
    ]


def test_the_document_has_the_counters_by_robot() -> None:
    document = json.loads(render_view(ByteCountersView(FOUND), OutputFormat.JSON))
    assert document["kind"] == "byte-counter"
    assert document["items"][0]["robot_counters"]["robot1"]["rx_bytes"] == 5e6
    assert render_view(ByteCountersView(FOUND), OutputFormat.NAME) == "edge/edge1\nedge/edge2\n"
