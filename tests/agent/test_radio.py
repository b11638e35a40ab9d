# SPDX-License-Identifier: Apache-2.0
"""Bit rates of radios, from files of a fixture tree and from the output of a stand-in for iw(8)."""

import os
from pathlib import Path

import pytest

from edgectl.agent.measure import radio, radio_rate, wireless

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
    assert radio_rate.read_rates(["wlan0", "eth0", None]) == {"wlan0": 6.75e6}


@pytest.mark.parametrize(
    "text", ["Not connected.\n", "", "\ttx bitrate: unknown MBit/s x\n", "\ttx bitrate:\n"]
)
def test_a_radio_without_a_rate_states_none(text: str) -> None:
    assert radio_rate.parse_iw_link(text) == 0.0


# As iw 5.9 and a kernel with wireless extensions print them.
STATION = """Station 04:D5:90:00:00:01 (on wlan0)
	inactive time:	8 ms
	rx bytes:	9023114
	rx packets:	61021
	tx bytes:	2208110
	tx packets:	20110
	tx retries:	{retries}
	tx failed:	3
	signal:  	-61 [-64, -63] dBm
	signal avg:	-60 dBm
	tx bitrate:	54.0 MBit/s
	authorized:	yes
	connected time:	{joined} seconds
"""
WIRELESS = """Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE
 face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22
 wlan0: 0000   49.  -67.  -256        0      0      0     37     12        0
"""


def a_radio(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A host with one radio and an iw that prints the file that is returned."""
    (folder / "sys/class/net/wlan0/wireless").mkdir(parents=True)
    tool, printed = folder / "iw", folder / "station"
    tool.write_text(f"#!/bin/sh\n[ \"$*\" = 'dev wlan0 station dump' ] && cat {printed}\n")
    tool.chmod(0o755)
    monkeypatch.setattr(radio, "ROOT", str(folder))
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    return printed


def test_retries_and_the_access_point_of_a_radio_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = a_radio(tmp_path, monkeypatch)
    printed.write_text(STATION.format(retries=100, joined=3600))
    meter = wireless.RadioMeter()
    printed.write_text(STATION.format(retries=150, joined=3601))
    (entry,) = meter.measure().values()
    assert (entry["level_dbm"], entry["access_point"], entry["joined_s"]) == (-61, "04:d5:90:00:00:01", 3601)
    assert entry["retries_per_s"] > 0
    roamed = STATION.format(retries=2, joined=0).replace(":01 (", ":02 (")
    printed.write_text(roamed)
    (entry,) = meter.measure().values()
    assert (entry["retries_per_s"], entry["access_point"], entry["joined_s"]) == (
        None,
        "04:d5:90:00:00:02",
        0,
    )
    # An access point has many stations, and has joined none.
    printed.write_text(roamed + STATION.format(retries=9, joined=9))
    (entry,) = meter.measure().values()
    assert (entry["level_dbm"], entry["access_point"]) == (None, "")


def test_without_iw_the_kernel_s_file_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a_radio(tmp_path, monkeypatch)
    (tmp_path / "proc/net").mkdir(parents=True)
    (tmp_path / "proc/net/wireless").write_text(WIRELESS)
    (state,) = wireless.read_radios().values()
    assert (state.level_dbm, state.retries, state.access_point) == (-67.0, 37, "")
    assert wireless.parse_wireless(WIRELESS.replace("-67.", " 43."))["wlan0"].level_dbm is None
    assert wireless.parse_wireless(WIRELESS.replace("37", "?"))["wlan0"].retries is None
    assert wireless.parse_wireless("") == {}


def test_a_host_without_a_radio_runs_no_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sys/class/net/eth0").mkdir(parents=True)
    monkeypatch.setattr(radio, "ROOT", str(tmp_path))
    monkeypatch.setattr(radio_rate, "run_iw", None)
    assert wireless.RadioMeter().measure() == {}
