"""Plan to and from JSON: what was decided with every number, and the snapshot it was decided from."""

from edgectl.formats import snapshot as snapshot_format
from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, encode_optional, without_none
from edgectl.formats.document_reader import DocumentReader, check_no_faults, open_document
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
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName, SequenceRule, Weights
from edgectl.model.resource import (
    HOST_RESOURCES,
    NETWORK,
    RESOURCES,
    RESOURCES_BY_NAME,
    TERMS,
    Resource,
    Usage,
)
from edgectl.units import format_instant


def encode(plan: Plan) -> Document:
    """The JSON form. What the format does not name (options of the policy, instances) stands in keys of its own."""
    document: Document = {
        "format_version": FORMAT_VERSION,
        "created_at": format_instant(plan.created_at),
        **encode_policy(plan.policy),
        "inventory_digest": plan.inventory_digest,
        "tasks_digest": plan.tasks_digest,
        "settled": plan.settled,
        "frozen": plan.frozen,
        "unseen": list(plan.unseen),
        "decisions": [_encode_step(step) for step in plan.steps],
        "expected": {name: _encode_expected_load(load) for name, load in plan.expected.items()},
        "uneven": [_encode_uneven(found) for found in plan.demand_spreads],
        "summary": {action.value: count for action, count in plan.summary.items()},
        "snapshot": snapshot_format.encode(plan.snapshot),
    }
    return document


def encode_policy(policy: Policy) -> Document:
    """The policy's part of a plan."""
    return {
        "policy": policy.name.value,
        "weights": _encode_weights(policy.weights),
        "options": _encode_options(policy),
    }


def _encode_weights(weights: Weights) -> Document:
    return {name: encode_number(weight) for name, weight in weights.items()}


def _encode_options(policy: Policy) -> Document:
    return {
        "sequence": policy.sequence.value,
        "move_margin": encode_number(policy.move_margin),
        "min_dwell_s": encode_number(policy.min_dwell),
        "max_moves": policy.max_moves,
        "attended": policy.attended,
        "best_effort": policy.best_effort,
        "full": policy.full,
        "without": sorted(policy.without),
    }


def _encode_step(step: Step) -> Document:
    decision = step.decision
    document: Document = {
        "task": decision.task,
        "host": decision.host,
        "previous_host": decision.previous_host,
        "action": step.action.value,
        "verdict": decision.verdict.value,
        "reason": decision.reason.value,
        "total": encode_optional(decision.total),
        "lead": encode_optional(decision.lead),
    }
    document |= without_none(
        challenger=decision.challenger,
        subject=decision.subject,
        amount=encode_optional(decision.amount),
        cost=None if decision.cost is None else _encode_move_cost(decision.cost),
        nearest=decision.nearest,
        overcommitted=decision.overcommitted or None,
        instances=dict(step.instances) or None,
        stop=list(step.stop) or None,
        changed=list(step.changed) or None,
        rejection_counts=dict(decision.rejection_counts) or None,
        demand=_encode_demand(decision.demand),
    )
    document["ranking"] = [_encode_ranked_host(host) for host in decision.ranking]
    return document


def _encode_ranked_host(ranked: RankedHost) -> Document:
    return {
        "host": ranked.host,
        "rank": ranked.rank,
        "total": encode_optional(ranked.total),
        "terms": {name: encode_optional(term) for name, term in ranked.terms.items()},
        "affinity": ranked.affinity,
        "feasible": ranked.feasible,
        "rejections": [_encode_rejection(rejection) for rejection in ranked.rejections],
    } | without_none(demand=_encode_demand(ranked.demand))


def _encode_demand(demand: tuple[ResourceDemand, ...]) -> Document | None:
    return {
        rho.resource.name: without_none(
            value=encode_number(rho.value), source=rho.source.value, samples=rho.samples
        )
        for rho in demand
    } or None


def _encode_uneven(found: DemandSpread) -> Document:
    return {
        "task": found.task,
        "resource": found.resource.name,
        "share": encode_number(found.share),
        "least": encode_number(found.least),
        "most": encode_number(found.most),
        "hosts": list(found.hosts),
    }


def _encode_rejection(rejection: Rejection) -> Document:
    return without_none(
        rule=rejection.rule.value,
        resource=None if rejection.resource is None else rejection.resource.name,
        robot=rejection.robot,
        demand=encode_optional(rejection.demand),
        used=encode_optional(rejection.used),
        capacity=encode_optional(rejection.capacity),
    )


def _encode_move_cost(cost: MoveCost) -> Document:
    return {
        "stay_s": encode_number(cost.stay_s),
        "downtime_s": encode_number(cost.downtime_s),
        "per_s": encode_number(cost.per_s),
    }


def _encode_expected_load(load: ExpectedLoad) -> Document:
    return {
        **{resource.used_key: encode_number(load.used[resource.name]) for resource in HOST_RESOURCES},
        "links": {robot: {NETWORK.used_key: encode_number(rate)} for robot, rate in load.links.items()},
    }


def decode(raw: object) -> Plan:
    """The plan in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "plan")
    for key in ("decisions", "expected"):
        reader.require(key)
    plan = Plan(
        created_at=reader.instant("created_at"),
        policy=decode_policy(reader),
        inventory_digest=reader.text("inventory_digest"),
        tasks_digest=reader.text("tasks_digest"),
        snapshot=snapshot_format.decode_nested(reader.child("snapshot")),
        settled=reader.flag("settled"),
        steps=tuple(_decode_step(step) for step in reader.items("decisions")),
        expected={name: _decode_expected_load(load) for name, load in reader.children("expected")},
        frozen=reader.flag("frozen", default=False),
        unseen=reader.texts("unseen"),
        demand_spreads=tuple(_decode_uneven(found) for found in reader.items("uneven")),
    )
    check_no_faults(reader, "plan")
    return plan


def decode_policy(reader: DocumentReader) -> Policy:
    """The policy in an object of a larger document; mistakes go to the reader."""
    weights, options = reader.child("weights"), reader.child("options")
    return Policy(
        name=reader.choice("policy", PolicyName),
        weights=Weights({name: weights.number(name) for name in TERMS}),
        sequence=options.choice("sequence", SequenceRule),
        move_margin=options.number("move_margin"),
        min_dwell=options.number("min_dwell_s"),
        max_moves=options.integer("max_moves") if options.has("max_moves") else None,
        attended=options.flag("attended"),
        best_effort=options.flag("best_effort"),
        full=options.flag("full"),
        without=frozenset(options.texts("without")),
    )


def _decode_step(reader: DocumentReader) -> Step:
    return Step(
        decision=_decode_decision(reader),
        action=reader.choice("action", Action),
        instances=reader.mapping("instances", DocumentReader.text),
        stop=reader.texts("stop"),
        changed=reader.texts("changed"),
    )


def _decode_decision(reader: DocumentReader) -> Decision:
    reader.require("ranking")
    return Decision(
        task=reader.text("task"),
        verdict=reader.choice("verdict", Verdict),
        reason=reader.choice("reason", Reason),
        host=reader.maybe_text("host"),
        previous_host=reader.maybe_text("previous_host"),
        total=reader.maybe_number("total", minimum=None),
        lead=reader.maybe_number("lead", minimum=None),
        challenger=reader.maybe_text("challenger"),
        subject=reader.maybe_text("subject"),
        amount=reader.maybe_number("amount", minimum=None),
        cost=_decode_move_cost(reader.child("cost")) if reader.has("cost") else None,
        nearest=reader.maybe_text("nearest"),
        overcommitted=reader.flag("overcommitted", default=False),
        ranking=tuple(_decode_ranked_host(ranked) for ranked in reader.items("ranking")),
        rejection_counts=reader.mapping("rejection_counts", DocumentReader.integer),
        demand=_decode_demand(reader),
    )


def _decode_ranked_host(reader: DocumentReader) -> RankedHost:
    terms = reader.child("terms")
    return RankedHost(
        host=reader.text("host"),
        rank=reader.integer("rank"),
        total=reader.maybe_number("total", minimum=None),
        terms=UtilityTerms({name: terms.maybe_number(name, minimum=None) for name in TERMS}),
        feasible=reader.flag("feasible"),
        affinity=reader.integer("affinity", 0, minimum=None),
        rejections=tuple(_decode_rejection(rejection) for rejection in reader.items("rejections")),
        demand=_decode_demand(reader),
    )


def _decode_demand(reader: DocumentReader) -> tuple[ResourceDemand, ...]:
    inner = reader.maybe_child("demand")
    if inner is None:
        return ()
    return tuple(
        _decode_resource_demand(inner.child(resource.name), resource)
        for resource in RESOURCES
        if inner.has(resource.name)
    )


def _decode_resource_demand(reader: DocumentReader, resource: Resource) -> ResourceDemand:
    return ResourceDemand(
        resource=resource,
        value=reader.number("value"),
        source=reader.choice("source", DemandSource),
        samples=reader.integer("samples") if reader.has("samples") else None,
    )


def _decode_uneven(reader: DocumentReader) -> DemandSpread:
    hosts = (*reader.texts("hosts"), "", "")
    return DemandSpread(
        task=reader.text("task"),
        resource=reader.named("resource", RESOURCES_BY_NAME),
        share=reader.number("share"),
        least=reader.number("least"),
        most=reader.number("most"),
        hosts=(hosts[0], hosts[1]),
    )


def _decode_rejection(reader: DocumentReader) -> Rejection:
    return Rejection(
        rule=reader.choice("rule", RejectionRule),
        resource=reader.named("resource", RESOURCES_BY_NAME) if reader.has("resource") else None,
        robot=reader.maybe_text("robot"),
        demand=reader.maybe_number("demand", minimum=None),
        used=reader.maybe_number("used", minimum=None),
        capacity=reader.maybe_number("capacity", minimum=None),
    )


def _decode_move_cost(reader: DocumentReader) -> MoveCost:
    return MoveCost(
        stay_s=reader.number("stay_s", positive=True),
        downtime_s=reader.number("downtime_s"),
        per_s=reader.number("per_s"),
    )


def _decode_expected_load(reader: DocumentReader) -> ExpectedLoad:
    return ExpectedLoad(
        used=Usage(
            {
                resource.name: reader.number(resource.used_key, minimum=None)
                for resource in HOST_RESOURCES
                if not resource.declared_only or reader.has(resource.used_key)
            }
        ),
        links={
            robot: link.number(NETWORK.used_key, minimum=None) for robot, link in reader.children("links")
        },
    )
