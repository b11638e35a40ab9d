"""Bit rates of radios, from files of a fixture tree and from the output of a stand-in for iw(8)."""

import os
from pathlib import Path

import pytest

from edgectl.agent.measure import radio

CONNECTED = """Connected to 04:d5:90:00:00:01 (on wlan0)
	SSID: lab
	freq: 5180
	signal: -61 dBm
	rx bitrate: 866.7 MBit/s VHT-MCS 9 80MHz short GI VHT-NSS 2
	tx bitrate: 54.0 MBit/s
"""


def test_the_rate_of_a_radio_is_what_iw_states(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sys/class/net/wlan0/wireless").mkdir(parents=True)
    (tmp_path / "sys/class/net/eth0").mkdir()
    tool = tmp_path / "iw"
    tool.write_text(f"#!/bin/sh\n[ \"$*\" = 'dev wlan0 link' ] && cat <<'END'\n{CONNECTED}END\n")
    tool.chmod(0o755)
    monkeypatch.setattr(radio, "ROOT", str(tmp_path))
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert radio.list_radios() == ["wlan0"]
    assert radio.read_rates(["wlan0", "eth0", None]) == {"wlan0": 6.75e6}


@pytest.mark.parametrize(
    "text", ["Not connected.\n", "", "\ttx bitrate: unknown MBit/s x\n", "\ttx bitrate:\n"]
)
def test_a_radio_without_a_rate_states_none(text: str) -> None:
    assert radio.parse_iw_link(text) == 0.0
