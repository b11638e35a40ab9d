# SPDX-License-Identifier: Apache-2.0
"""Measured demand (ADR 0025): classes of hosts, sufficiency of the history, and the demand until then."""

from collections.abc import Collection, Iterable, Mapping
from math import log2

from edgectl.model.demand import Demand, Quantity
from edgectl.model.inventory import Host
from edgectl.model.manager_state import MeasuredDemand
from edgectl.model.resource import TASK_RESOURCES
from edgectl.model.task import Task

# Start-up is not typical use: what a task used in these first seconds does not count.
WARM_UP_S = 10.0
# So many samples, over so many seconds, make a figure.
MIN_SAMPLES, MIN_SPAN_S = 60, 300.0
# The label that puts hosts into one class by the operator's word.
CLASS_LABEL = "class"
_GIB = 2.0**30
# Of the demands that managers share; one that is off by less than a tenth is not shared anew.
MAX_SHARED, _OFF = 4096, 0.1
MeasuredDemands = Mapping[tuple[str, str], MeasuredDemand]


def classify_host(host: Host, cores: float, total_bytes: float) -> str:
    """Hosts of one class are taken to run a task at the same cost: the label ``class``, else cores and
    nominal memory (``4c-8Gi``).
    """
    if CLASS_LABEL in host.labels:
        return host.labels[CLASS_LABEL]
    return f"{round(cores, 1):g}c-{_round_to_nominal_bytes(total_bytes) / _GIB:g}Gi"


def _round_to_nominal_bytes(total: float) -> float:
    """The least of 2^n and 3 x 2^(n-1) bytes that holds ``total`` (> 0): what a kernel shows is a little less
    than what was bought.
    """
    power = 2.0 ** (int(log2(total)) + 1)
    return next(size for size in (power / 2, power * 3 / 4, power) if total <= size)


def has_enough_samples(found: MeasuredDemand) -> bool:
    """Whether there are enough samples."""
    return found.samples >= MIN_SAMPLES and found.span_s >= MIN_SPAN_S


def is_of_current_spec(task: Task, found: MeasuredDemand) -> bool:
    """Whether it was measured of the task as it is specified now: the history of another command does not
    count.
    """
    return found.spec_hash in ("", task.spec_hash)


def follows_history(demand: Demand) -> bool:
    """Whether any resource of ``demand`` counts as measured once it is."""
    return any(
        (quantity := demand[resource.name]) is None or quantity.measured for resource in TASK_RESOURCES
    )


def resolve_demand(demand: Demand, found: MeasuredDemand) -> Demand:
    """``demand`` on hosts of a class with enough history: every resource that follows history is as measured
    there.
    """
    return Demand.from_complete(
        {name: _prefer_measured(quantity, found.used.get(name)) for name, quantity in demand.items()}
    )


def _prefer_measured(stated: Quantity | None, value: float | None) -> Quantity | None:
    follows = stated is None or stated.measured
    return Quantity(value=value, measured=True) if follows and value is not None else stated


def estimate_demand(demand: Demand, found: Iterable[MeasuredDemand]) -> Demand:
    """``demand`` on a class of hosts without enough history, known from others: what is declared, else the
    most that was measured.
    """
    most: dict[str, float] = {}
    for each in found:
        for name, value in each.used.items():
            most[name] = max(value, most.get(name, value))
    return Demand.from_complete(
        {
            name: stated if _is_declared(stated) else _prefer_measured(stated, most.get(name))
            for name, stated in demand.items()
        }
    )


def _is_declared(stated: Quantity | None) -> bool:
    return stated is not None and (stated.value > 0 or not stated.measured)


def prefer_own_demands(own: MeasuredDemands, shared: MeasuredDemands) -> MeasuredDemands:
    """What one manager has measured, with what another one did where its own samples are not enough."""
    return {**own, **{key: found for key, found in shared.items() if not _is_enough(own.get(key))}}


def select_shared_demands(
    shared: MeasuredDemands, measured: MeasuredDemands, tasks: Collection[str]
) -> MeasuredDemands:
    """``shared`` brought up to date with ``measured``: with what is new, of another specification or off by a
    tenth.

    At most `MAX_SHARED` of them, those of ``tasks`` first, in order of names.
    """
    newer = {
        key: found
        for key, found in measured.items()
        if _is_enough(found) and _differs(shared.get(key), found)
    }
    every = {**shared, **newer}
    order = sorted(every, key=lambda key: (key[0] not in tasks, key))
    return {key: every[key] for key in sorted(order[:MAX_SHARED])}


def _is_enough(found: MeasuredDemand | None) -> bool:
    return found is not None and has_enough_samples(found)


def _differs(old: MeasuredDemand | None, new: MeasuredDemand) -> bool:
    if old is None or old.spec_hash != new.spec_hash or old.used.keys() != new.used.keys():
        return True
    return any(abs(new.used[name] - value) > _OFF * value for name, value in old.used.items())
