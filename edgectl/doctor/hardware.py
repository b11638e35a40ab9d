# SPDX-License-Identifier: Apache-2.0
"""Check of GPU, power, battery and temperature: what is stated of a host must be readable there."""

from edgectl.model.diagnosis import Finding, HardwareFacts, Severity
from edgectl.model.inventory import Host
from edgectl.model.resource import BATTERY, GPU, POWER
from edgectl.units import format_bytes, format_watts

CHECK = "hardware"


def diagnose_hardware(host: Host, facts: HardwareFacts) -> list[Finding]:
    """One finding where the host has such hardware or the inventory states something of it, else none."""
    found = _describe_hardware(facts)
    missing = _find_unreadable(host, facts)
    if missing:
        message = f"{missing[0]}, and {host.name} shows none" + (f"; it has {found}" if found else "")
        return [_build_finding(host, Severity.WARNING, message, missing[1])]
    highest, now = host.max_temperature, facts.temperature_c
    if highest is not None and now is not None and now >= highest:
        message = f"is at {now:.0f}C, its max_temperature is {highest:.0f}C: a quarter of its cores is usable"
        return [
            _build_finding(host, Severity.WARNING, message, f"cool {host.name}, or move tasks away from it")
        ]
    return [_build_finding(host, Severity.OK, found, "")] if found else []


def _build_finding(host: Host, level: Severity, message: str, remedy: str) -> Finding:
    return Finding(host=host.name, check=CHECK, level=level, message=message, remedy=remedy)


def _describe_hardware(facts: HardwareFacts) -> str:
    """What was read; a temperature alone, as most hosts have one, is not worth a line."""
    parts = []
    if facts.gpus:
        memory = f" with {format_bytes(facts.gpu_total_bytes)}" if facts.gpu_total_bytes else ""
        parts.append(f"{facts.gpus:g} GPU{'s' if facts.gpus > 1 else ''}{memory}")
    if facts.used_watts is not None:
        parts.append(f"draws {format_watts(facts.used_watts)}")
    if facts.used_charge is not None:
        parts.append(f"battery at {1 - facts.used_charge:.0%}")
    if parts and facts.temperature_c is not None:
        parts.append(f"{facts.temperature_c:.0f}C")
    return ", ".join(parts)


def _find_unreadable(host: Host, facts: HardwareFacts) -> tuple[str, str] | None:
    """(what the inventory states that cannot be read, remedy)."""
    declared = host.capacity
    if host.max_temperature is not None and facts.temperature_c is None:
        return (
            "max_temperature needs a sensor",
            "remove max_temperature: of it, or load the driver of its sensors",
        )
    if declared is not None and declared[POWER.name] and facts.used_watts is None:
        hint = "it counts what tasks demand alone; as root, /sys/class/powercap can be made readable"
        return "a budget of power needs a sensor", hint
    if host.limits[BATTERY.name] != 1 and facts.used_charge is None:
        return "a limit of the battery needs one", "remove battery: from its limits"
    if declared is not None and declared[GPU.name] and not host.is_slice and not facts.gpus:
        return "a declared GPU needs a driver", "install nvidia-smi, or remove gpu: from its capacity"
    return None
