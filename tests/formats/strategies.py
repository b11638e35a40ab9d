"""Hypothesis strategies for every value that can stand in a snapshot, a memory or a plan."""

from typing import TypeVar

from hypothesis import strategies as st

from edgectl.model.assignment import (
    Decision,
    DemandSource,
    DemandSpread,
    ExpectedLoad,
    MoveCost,
    RankedHost,
    Reason,
    Rejection,
    RejectionRule,
    ResourceDemand,
    UtilityTerms,
    Verdict,
)
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState, MeasuredDemand, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName, SequenceRule, Weights
from edgectl.model.resource import HOST_RESOURCES, RESOURCES, Usage
from edgectl.model.snapshot import (
    CapacitySource,
    DeviceSample,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)

T = TypeVar("T")

names = st.from_regex(r"[a-z0-9][a-z0-9._-]{0,8}", fullmatch=True)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
amounts = st.floats(min_value=0, max_value=1e15)
positive = st.floats(min_value=1e-3, max_value=1e15)
signed = st.floats(min_value=-1e9, max_value=1e9)
instants = st.integers(0, 4_000_000_000_000).map(lambda ms: ms / 1000)
counts = st.integers(0, 2**40)


def maybe(strategy: st.SearchStrategy[T]) -> st.SearchStrategy[T | None]:
    return st.none() | strategy


def by_name(strategy: st.SearchStrategy[T]) -> st.SearchStrategy[dict[str, T]]:
    return st.dictionaries(names, strategy, max_size=3)


links = st.builds(
    LinkSample,
    capacity_bytes_per_s=amounts,
    used_bytes_per_s=amounts,
    rtt_ms=maybe(amounts),
    capacity_source=st.sampled_from(CapacitySource),
)
task_samples = st.builds(
    TaskSample,
    state=st.sampled_from(TaskState),
    pid=counts,
    started_at=instants,
    used=st.builds(Usage, cpu=amounts, memory=amounts, network=amounts),
    links=maybe(by_name(amounts)),
    instance=texts,
    spec_hash=texts,
    generation=counts,
    managed=st.booleans(),
    restarts=counts,
    exit_code=maybe(st.integers(-255, 255)),
    detail=texts,
    fields=by_name(texts),
    last_exit=maybe(st.integers(-255, 255)),
    log_tail=st.lists(texts, max_size=2).map(tuple),
    limits=texts,
    given_up=st.booleans(),
    ended_at=maybe(instants),
    metrics=st.dictionaries(names, st.floats(allow_nan=False, allow_infinity=False), max_size=3),
)
interfaces = st.builds(
    InterfaceSample, rx_bytes_per_s=amounts, tx_bytes_per_s=amounts, speed_bytes_per_s=maybe(amounts)
)
devices = st.builds(
    DeviceSample,
    load_1m=maybe(amounts),
    temperature_c=maybe(signed),
    gpu_share=maybe(amounts),
    boot_id=texts,
    clock_skew_s=maybe(signed),
    interfaces=by_name(interfaces),
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
    links=by_name(links),
    tasks=by_name(task_samples),
    device=devices,
    generations=by_name(counts),
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
    placements=by_name(st.builds(Placement, host=names, since=instants, spec_hash=texts, generation=counts)),
    first=by_name(names),
    cordons=st.frozensets(names, max_size=3),
    draining=st.frozensets(names, max_size=3),
    done=by_name(texts),
    downtimes=st.dictionaries(st.tuples(names, names), st.lists(amounts, max_size=3).map(tuple), max_size=2),
    stays=by_name(st.lists(amounts, max_size=3).map(tuple)),
    contact=by_name(instants),
    fenced=st.frozensets(names, max_size=3),
    deferred=by_name(texts),
    measured=st.dictionaries(
        st.tuples(names, names),
        st.builds(
            MeasuredDemand,
            samples=counts,
            span_s=amounts,
            used=st.fixed_dictionaries(
                {resource.name: amounts for resource in HOST_RESOURCES}, optional={"network": amounts}
            ),
            spec_hash=texts,
        ),
        max_size=2,
    ),
)
snapshots = st.builds(Snapshot, taken_at=instants, hosts=by_name(hosts), manager=maybe(memories))

rejections = st.builds(
    Rejection,
    rule=st.sampled_from(RejectionRule),
    resource=maybe(st.sampled_from(RESOURCES)),
    robot=maybe(names),
    demand=maybe(amounts),
    used=maybe(amounts),
    capacity=maybe(amounts),
)
demands = st.lists(
    st.builds(
        ResourceDemand,
        resource=st.sampled_from(RESOURCES),
        value=amounts,
        source=st.sampled_from(DemandSource),
        samples=maybe(counts),
    ),
    unique_by=lambda rho: rho.resource,
    max_size=3,
).map(lambda found: tuple(sorted(found, key=lambda rho: RESOURCES.index(rho.resource))))
ranked = st.builds(
    RankedHost,
    host=names,
    rank=st.integers(0, 99),
    total=maybe(signed),
    terms=st.builds(
        UtilityTerms, cpu=maybe(signed), memory=maybe(signed), network=maybe(signed), task=maybe(signed)
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
    host=maybe(names),
    previous_host=maybe(names),
    total=maybe(signed),
    lead=maybe(signed),
    challenger=maybe(names),
    subject=maybe(texts),
    amount=maybe(signed),
    cost=maybe(st.builds(MoveCost, stay_s=positive, downtime_s=amounts, per_s=amounts)),
    nearest=maybe(names),
    overcommitted=st.booleans(),
    ranking=st.lists(ranked, max_size=2).map(tuple),
    rejection_counts=by_name(counts),
    demand=demands,
)
steps = st.builds(
    Step,
    decision=decisions,
    action=st.sampled_from(Action),
    instances=by_name(texts),
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
    max_moves=maybe(counts),
    attended=st.booleans(),
    best_effort=st.booleans(),
    full=st.booleans(),
    without=st.frozensets(names, max_size=2),
)
plans = st.builds(
    Plan,
    created_at=instants,
    policy=policies,
    inventory_digest=texts,
    tasks_digest=texts,
    snapshot=snapshots,
    settled=st.booleans(),
    steps=st.lists(steps, max_size=3).map(tuple),
    expected=by_name(
        st.builds(ExpectedLoad, used=st.builds(Usage, cpu=signed, memory=signed), links=by_name(signed))
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
