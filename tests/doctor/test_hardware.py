# SPDX-License-Identifier: Apache-2.0
"""Check of GPU, power, battery and temperature."""

import pytest

from edgectl.doctor.hardware import diagnose_hardware
from edgectl.model.diagnosis import HardwareFacts, Severity
from edgectl.model.inventory import Capacity, Host, Limits, Role

READINGS = HardwareFacts(
    gpus=2.0, gpu_total_bytes=16 * 2**30, used_watts=20.68, used_charge=0.63, temperature_c=61.3
)
NOTHING = HardwareFacts(temperature_c=50.0)


def a_host(**fields: object) -> Host:
    return Host(name="zeta", role=Role.EDGE, host="10.0.0.1", **fields)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("host", "facts", "message"),
    [
        (a_host(), NOTHING, None),
        (a_host(max_temperature=85.0), NOTHING, None),
        (a_host(), READINGS, "2 GPUs with 16.0Gi, draws 20.7W, battery at 37%, 61C"),
    ],
)
def test_what_is_there_is_told(host: Host, facts: HardwareFacts, message: str | None) -> None:
    found = [(each.level, each.message) for each in diagnose_hardware(host, facts)]
    assert found == ([] if message is None else [(Severity.OK, message)])


@pytest.mark.parametrize(
    ("host", "facts", "words"),
    [
        (a_host(max_temperature=85.0), HardwareFacts(), "max_temperature needs a sensor"),
        (a_host(capacity=Capacity(power=30.0)), NOTHING, "a budget of power needs a sensor"),
        (a_host(limits=Limits(battery=0.8)), NOTHING, "a limit of the battery needs one"),
        (a_host(capacity=Capacity(gpu=1.0)), NOTHING, "a declared GPU needs a driver"),
        (a_host(max_temperature=60.0), READINGS, "is at 61C, its max_temperature is 60C"),
    ],
)
def test_what_is_stated_and_cannot_be_read_is_a_warning(host: Host, facts: HardwareFacts, words: str) -> None:
    (found,) = diagnose_hardware(host, facts)
    assert (found.level, found.message.startswith(words)) == (Severity.WARNING, True), found
    assert found.remedy


def test_a_slice_declares_its_gpu_alone() -> None:
    host = a_host(capacity=Capacity(cpu=2.0, memory=1e9, gpu=1.0))
    assert diagnose_hardware(host, HardwareFacts()) == []
