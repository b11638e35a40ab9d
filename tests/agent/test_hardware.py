# SPDX-License-Identifier: Apache-2.0
"""GPU, power and battery as read from the trees of hosts that have them, and from nvidia-smi."""

import os
import sys
import time
from pathlib import Path

import pytest

from edgectl.agent.measure import device, hardware
from tests.agent.hardware_trees import AGX_ORIN, ORIN_NANO, ROBOT_NUC, WORKSTATION, XAVIER_NX, make_tree

# As nvidia-smi prints it: two cards, the second of which states no power.
TWO_CARDS = "35, 1024, 24564, 71.25\n4, 300, 8192, [N/A]\n"


@pytest.fixture(autouse=True)
def no_card(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A PATH without the tool of a driver that this machine may have."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


@pytest.mark.parametrize(
    ("tree", "share", "watts", "celsius"),
    [
        (AGX_ORIN, 0.742, 19.192 * 0.624 + 19.184 * 0.208 + 4.992 * 0.944, 61.343),
        (ORIN_NANO, 0.0, 4.928 * 1.256, 47.125),
        (XAVIER_NX, 0.318, 5.287, 44.5),
    ],
)
def test_a_jetson(tmp_path: Path, tree: dict[str, str], share: float, watts: float, celsius: float) -> None:
    root = make_tree(tmp_path / "host", tree)
    meter = device.start_hardware_meter(root)
    found = device.measure_hardware(meter)
    assert found["gpu"] == {"gpus": 1.0, "used_gpus": share}
    assert found["gpu_share"] == share
    assert found["power"]["used_watts"] == pytest.approx(watts, abs=0.01)
    assert found["gpu_memory"]["gpu_total_bytes"] == device.read_machine_memory()[0]
    assert "battery" not in found
    assert device.read_temperature_c(root) == celsius


def test_a_battery_that_discharges(tmp_path: Path) -> None:
    root = make_tree(tmp_path / "host", ROBOT_NUC)
    found = device.measure_hardware(device.start_hardware_meter(root))
    assert found["battery"] == {"full_charge": 1.0, "used_charge": 0.63}
    assert found["power"] == {"used_watts": pytest.approx(24.11 * 1.75, abs=0.01)}
    assert found["gpu_share"] is None


def test_a_battery_that_is_charged_tells_no_draw(tmp_path: Path) -> None:
    root = make_tree(tmp_path / "host", ROBOT_NUC | {"sys/class/power_supply/BAT0/status": "Charging"})
    assert "power" not in device.measure_hardware(device.start_hardware_meter(root))


def test_processor_packages_by_their_counters(tmp_path: Path) -> None:
    """The counter of the first package begins anew meanwhile; parts and the platform do not count twice."""
    root = make_tree(tmp_path / "host", WORKSTATION)
    meter = device.start_hardware_meter(root)
    assert meter is not None
    began = time.monotonic()
    zone = tmp_path / "host/sys/class/powercap"
    (zone / "intel-rapl:0/energy_uj").write_text("6671150\n")  # 10 J after 262140 J of 262143.32885 J
    (zone / "intel-rapl:1/energy_uj").write_text("21000000\n")  # 20 J
    (zone / "intel-rapl:2/energy_uj").write_text("900000000\n")
    while time.monotonic() < began + 0.2:
        time.sleep(0.01)
    watts = device.measure_hardware(meter)["power"]["used_watts"]
    assert 0.5 * 30 / (time.monotonic() - began + 0.05) < watts <= 30 / 0.2


def test_a_counter_that_only_root_may_read_is_no_reading(tmp_path: Path) -> None:
    root = make_tree(tmp_path / "host", WORKSTATION)
    for path in (tmp_path / "host").rglob("energy_uj"):
        path.unlink()
    assert "power" not in device.measure_hardware(device.start_hardware_meter(root))


def test_cards_of_nvidia(no_card: Path, tmp_path: Path) -> None:
    tool = no_card / "nvidia-smi"
    tool.write_text(f"#!{sys.executable}\nimport sys\nassert '--format=csv,noheader,nounits' in sys.argv\n")
    with tool.open("a") as file:
        file.write(f"print({TWO_CARDS!r}, end='')\n")
    tool.chmod(0o755)
    found = device.measure_hardware(device.start_hardware_meter(str(tmp_path / "empty")))
    assert found["gpu"] == {"gpus": 2.0, "used_gpus": 0.39}
    assert found["gpu_memory"] == {"gpu_total_bytes": 32756 * 2**20, "gpu_used_bytes": 1324 * 2**20}
    assert found["gpu_share"] == pytest.approx(0.195)
    assert found["power"] == {"used_watts": 71.25}


def test_a_card_whose_driver_states_no_memory() -> None:
    """As a board on which the GPU shares the memory of the host."""
    found = hardware.parse_nvidia("97, [N/A], [N/A], [Not Supported]\n")
    assert found == ({"gpu": {"gpus": 1.0, "used_gpus": 0.97}}, [])


@pytest.mark.parametrize("text", ["", "No devices were found\n", "a, b, c, d\n", "1, 2\n", "-5, 1, 2, 3\n"])
def test_an_answer_without_a_card(text: str) -> None:
    assert hardware.parse_nvidia(text)[0] == {}


def test_a_tool_that_fails_is_no_gpu(no_card: Path, tmp_path: Path) -> None:
    tool = no_card / "nvidia-smi"
    tool.write_text("#!/bin/sh\nexit 9\n")
    tool.chmod(0o755)
    found = device.measure_hardware(device.start_hardware_meter(str(tmp_path / "empty")))
    assert found == {"gpu_share": None}


def test_a_host_without_any_opens_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed: list[str] = []
    opened: list[str] = []
    listdir, opening = os.listdir, os.open

    def list_folder(path: str) -> list[str]:
        listed.append(path)
        return listdir(path)

    def open_file(path: str, flags: int) -> int:
        opened.append(path)
        return opening(path, flags)

    monkeypatch.setattr(os, "listdir", list_folder)
    monkeypatch.setattr(os, "open", open_file)
    meter = device.start_hardware_meter(str(tmp_path / "empty"))
    assert (meter, device.measure_hardware(meter)) == (None, {"gpu_share": None})
    assert (len(listed), opened) == (6, [])
