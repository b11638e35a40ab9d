# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies for every value of a snapshot, a manager state or a plan."""

from typing import TypeVar

from hypothesis import strategies as st

from edgectl.model.assignment import (
    Decision,
    DemandSource,
    DemandSpread,
    ExpectedLoad,
    MoveCost,
    OperatorPin,
    RankedHost,
    Reason,
    Rejection,
    RejectionRule,
    ResourceDemand,
    UtilityTerms,
    Verdict,
)
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState, MeasuredDemand, Pin, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName, SequenceRule, Weights
from edgectl.model.resource import HOST_RESOURCES, MEASURED_HOST_RESOURCES, RESOURCES, Usage
from edgectl.model.snapshot import (
    CapacitySource,
    DeviceSample,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    OtherTask,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.model.text import clean_text

T = TypeVar("T")

names = st.from_regex(r"[a-z0-9][a-z0-9._-]{0,8}", fullmatch=True)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
amounts = st.floats(min_value=0, max_value=1e15)
positive = st.floats(min_value=1e-3, max_value=1e15)
signed = st.floats(min_value=-1e9, max_value=1e9)
instants = st.integers(0, 4_000_000_000_000).map(lambda ms: ms / 1000)
counts = st.integers(0, 2**40)


def optional_of(strategy: st.SearchStrategy[T]) -> st.SearchStrategy[T | None]:
    return st.none() | strategy


def dictionaries_of(strategy: st.SearchStrategy[T]) -> st.SearchStrategy[dict[str, T]]:
    return st.dictionaries(names, strategy, max_size=3)


links = st.builds(
    LinkSample,
    capacity_bytes_per_s=amounts,
    used_bytes_per_s=amounts,
    rtt_ms=optional_of(amounts),
    capacity_source=st.sampled_from(CapacitySource),
    capacity_age_s=optional_of(amounts),
    nominal=optional_of(amounts),
)
task_samples = st.builds(
    TaskSample,
    state=st.sampled_from(TaskState),
    pid=counts,
    started_at=instants,
    used=st.builds(Usage, cpu=amounts, memory=amounts, network=amounts),
    links=optional_of(dictionaries_of(amounts)),
    instance=texts,
    spec_hash=texts,
    generation=counts,
    managed=st.booleans(),
    restarts=counts,
    exit_code=optional_of(st.integers(-255, 255)),
    detail=texts,
    fields=dictionaries_of(texts),
    last_exit=optional_of(st.integers(-255, 255)),
    log_tail=st.lists(texts, max_size=2).map(tuple),
    limits=texts,
    given_up=st.booleans(),
    ended_at=optional_of(instants),
    metrics=st.dictionaries(names, st.floats(allow_nan=False, allow_infinity=False), max_size=3),
)
interfaces = st.builds(
    InterfaceSample, rx_bytes_per_s=amounts, tx_bytes_per_s=amounts, speed_bytes_per_s=optional_of(amounts)
)
# What a host reports of others is made printable when it is read.
reported_texts = texts.map(clean_text)
other_tasks = st.builds(
    OtherTask,
    fleet=reported_texts,
    host=names,
    task=names,
    state=st.sampled_from(TaskState),
    started_by=reported_texts,
    age_s=st.floats(min_value=0, max_value=1e8),
    instance=reported_texts,
    spec_hash=reported_texts,
    generation=st.integers(0, 2**31),
)
devices = st.builds(
    DeviceSample,
    load_1m=optional_of(amounts),
    temperature_c=optional_of(signed),
    gpu_share=optional_of(amounts),
    power_w=optional_of(amounts),
    boot_id=texts,
    pid_namespace=texts,
    clock_skew_s=optional_of(signed),
    interfaces=dictionaries_of(interfaces),
)
hosts = st.builds(
    HostSample,
    role=st.sampled_from(Role),
    status=st.just(HostStatus.OK),
    sample_age_s=amounts,
    resident=st.booleans(),
    usage=st.fixed_dictionaries(
        {
            resource.name: st.builds(ResourceUsage, capacity=positive, used=amounts)
            for resource in HOST_RESOURCES
        }
    ),
    links=dictionaries_of(links),
    tasks=dictionaries_of(task_samples),
    device=devices,
    generations=dictionaries_of(counts),
    other_tasks=st.lists(other_tasks, max_size=2).map(tuple),
    foreign_tasks=st.lists(other_tasks, max_size=2).map(tuple),
    grant=counts,
    foreign_grant=counts,
    foreign_hosts=st.lists(texts, max_size=2).map(tuple),
) | st.builds(
    HostSample,
    role=st.sampled_from(Role),
    status=st.just(HostStatus.UNREACHABLE),
    error=texts,
    error_kind=texts,
    hint=texts,
)
memories = st.builds(
    ManagerState,
    managed=st.booleans(),
    placements=dictionaries_of(
        st.builds(
            Placement,
            host=names,
            since=instants,
            spec_hash=texts,
            generation=counts,
            file=texts,
            address=texts,
            machine=texts,
        )
    ),
    first=dictionaries_of(names),
    cordons=st.frozensets(names, max_size=3),
    draining=st.frozensets(names, max_size=3),
    done=dictionaries_of(texts),
    downtimes=st.dictionaries(st.tuples(names, names), st.lists(amounts, max_size=3).map(tuple), max_size=2),
    stays=dictionaries_of(st.lists(amounts, max_size=3).map(tuple)),
    contact=dictionaries_of(instants),
    fenced=st.frozensets(names, max_size=3),
    deferred=dictionaries_of(texts),
    measured=st.dictionaries(
        st.tuples(names, names),
        st.builds(
            MeasuredDemand,
            samples=counts,
            span_s=amounts,
            used=st.fixed_dictionaries(
                {resource.name: amounts for resource in MEASURED_HOST_RESOURCES},
                optional={"network": amounts},
            ),
            spec_hash=texts,
        ),
        max_size=2,
    ),
    synced=dictionaries_of(counts),
    pins=dictionaries_of(
        st.builds(Pin, host=names, since=instants, until=optional_of(instants), machine=texts)
    ),
    noise=dictionaries_of(dictionaries_of(amounts)),
)
snapshots = st.builds(
    Snapshot, taken_at=instants, hosts=dictionaries_of(hosts), manager=optional_of(memories)
)

rejections = st.builds(
    Rejection,
    rule=st.sampled_from(RejectionRule),
    resource=optional_of(st.sampled_from(RESOURCES)),
    robot=optional_of(names),
    demand=optional_of(amounts),
    used=optional_of(amounts),
    capacity=optional_of(amounts),
)
demands = st.lists(
    st.builds(
        ResourceDemand,
        resource=st.sampled_from(RESOURCES),
        value=amounts,
        source=st.sampled_from(DemandSource),
        samples=optional_of(counts),
        demanded=optional_of(amounts),
    ),
    unique_by=lambda rho: rho.resource,
    max_size=3,
).map(lambda found: tuple(sorted(found, key=lambda rho: RESOURCES.index(rho.resource))))
ranked = st.builds(
    RankedHost,
    host=names,
    rank=st.integers(0, 99),
    total=optional_of(signed),
    terms=st.builds(
        UtilityTerms,
        cpu=optional_of(signed),
        memory=optional_of(signed),
        network=optional_of(signed),
        task=optional_of(signed),
    ),
    feasible=st.booleans(),
    affinity=st.integers(-9, 9),
    rejections=st.lists(rejections, max_size=2).map(tuple),
    demand=demands,
)
decisions = st.builds(
    Decision,
    task=names,
    verdict=st.sampled_from(Verdict),
    reason=st.sampled_from(Reason),
    host=optional_of(names),
    previous_host=optional_of(names),
    total=optional_of(signed),
    lead=optional_of(signed),
    challenger=optional_of(names),
    subject=optional_of(texts),
    amount=optional_of(signed),
    cost=optional_of(st.builds(MoveCost, stay_s=positive, downtime_s=amounts, per_s=amounts)),
    nearest=optional_of(names),
    overcommitted=st.booleans(),
    ranking=st.lists(ranked, max_size=2).map(tuple),
    rejection_counts=dictionaries_of(counts),
    demand=demands,
    pin=optional_of(
        st.builds(
            OperatorPin,
            host=names,
            until=optional_of(instants),
            set_aside=optional_of(st.sampled_from(RejectionRule)),
        )
    ),
)
steps = st.builds(
    Step,
    decision=decisions,
    action=st.sampled_from(Action),
    instances=dictionaries_of(texts),
    stop=st.lists(names, max_size=2).map(tuple),
    changed=st.lists(names, max_size=2).map(tuple),
)
policies = st.builds(
    Policy,
    name=st.sampled_from(PolicyName),
    weights=st.builds(Weights, cpu=amounts, memory=amounts, network=amounts, task=amounts),
    sequence=st.sampled_from(SequenceRule),
    move_margin=amounts,
    min_dwell=amounts,
    max_moves=optional_of(counts),
    attended=st.booleans(),
    best_effort=st.booleans(),
    full=st.booleans(),
    without=st.frozensets(names, max_size=2),
)
plans = st.builds(
    Plan,
    created_at=instants,
    fleet=texts,
    policy=policies,
    inventory_digest=texts,
    tasks_digest=texts,
    snapshot=snapshots,
    settled=st.booleans(),
    steps=st.lists(steps, max_size=3).map(tuple),
    expected=dictionaries_of(
        st.builds(
            ExpectedLoad, used=st.builds(Usage, cpu=signed, memory=signed), links=dictionaries_of(signed)
        )
    ),
    frozen=st.booleans(),
    unseen=st.lists(names, max_size=2).map(tuple),
    demand_spreads=st.lists(
        st.builds(
            DemandSpread,
            task=names,
            resource=st.sampled_from(RESOURCES),
            share=amounts,
            least=amounts,
            most=amounts,
            hosts=st.tuples(names, names),
        ),
        max_size=2,
    ).map(tuple),
)
