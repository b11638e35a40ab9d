# SPDX-License-Identifier: Apache-2.0
"""Every source file names its licence; what is sent to hosts does not."""

from edgectl.transport.agent_archive import build_agent_zipapp
from edgectl.transport.agent_client import build_packet
from tests.docs.spdx import ROOT, has_line, list_sources


def test_every_source_file_names_the_licence() -> None:
    sources = list(list_sources())
    assert len(sources) > 900
    missing = [path.relative_to(ROOT).as_posix() for path in sources if not has_line(path)]
    assert missing == [], "run: python -m tests.docs.spdx"


def test_hosts_are_not_sent_the_line() -> None:
    agent = build_agent_zipapp()
    packet = build_packet({"op": "probe"}, "marker", 1.0, agent)
    assert len(agent) > 100_000
    assert b"SPDX" not in agent
    assert b"SPDX" not in packet
