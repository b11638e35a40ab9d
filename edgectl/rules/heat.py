# SPDX-License-Identifier: Apache-2.0
"""Share of processors and GPU that is usable on a hot host (ADR 156)."""

from edgectl.model.inventory import Host
from edgectl.model.snapshot import HostSample

# Over so many degrees below the highest temperature the capacity falls, in a line, to the least share.
HEAT_RANGE_C, LEAST_COOL_SHARE = 15.0, 0.25


def compute_cool_share(host: Host, sample: HostSample | None) -> float:
    """The share of processors and GPU that heat leaves: 1 up to 15 degrees below ``max_temperature``, a
    quarter from there on; 1 where no sensor is read.
    """
    highest = host.max_temperature
    now = sample.device.temperature_c if sample is not None else None
    if highest is None or now is None:
        return 1.0
    over = (now - highest + HEAT_RANGE_C) / HEAT_RANGE_C
    return min(1.0, max(LEAST_COOL_SHARE, 1.0 - (1.0 - LEAST_COOL_SHARE) * over))


def describe_heat(host: Host, sample: HostSample | None) -> str:
    """``at 80C of 85C: 50% of its cores and GPU are usable``; empty where heat takes nothing."""
    share = compute_cool_share(host, sample)
    if share >= 1.0 or sample is None:
        return ""
    return (
        f"at {sample.device.temperature_c:.0f}C of {host.max_temperature:.0f}C: "
        f"{share:.0%} of its cores and GPU are usable"
    )
