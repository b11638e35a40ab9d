"""Manager state to and from JSON: part of a snapshot, and the manager's own cache file."""

from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, without_none
from edgectl.formats.document_reader import DocumentReader, check_no_faults, open_document
from edgectl.model.manager_state import ManagerState, MeasuredDemand, Placement
from edgectl.model.resource import RESOURCES, Resource
from edgectl.units import format_instant


def encode(memory: ManagerState) -> Document:
    """The JSON form; sets are sorted."""
    return {
        "format_version": FORMAT_VERSION,
        "managed": memory.managed,
        "placements": {task: _encode_placement(placement) for task, placement in memory.placements.items()},
        "first": dict(memory.first),
        "cordons": sorted(memory.cordons),
        "draining": sorted(memory.draining),
        "done": dict(memory.done),
        "downtimes": [
            {"task": task, "host": host, "seconds": [encode_number(value) for value in values]}
            for (task, host), values in memory.downtimes.items()
        ],
        "stays": {task: [encode_number(value) for value in values] for task, values in memory.stays.items()},
        "contact": {host: format_instant(at) for host, at in memory.contact.items()},
        "fenced": sorted(memory.fenced),
        "deferred": dict(memory.deferred),
        "measured": [
            {"task": task, "class": kind} | _encode_measured_demand(found)
            for (task, kind), found in sorted(memory.measured.items())
        ],
    }


def _encode_measured_demand(found: MeasuredDemand) -> Document:
    return without_none(
        samples=found.samples,
        span_s=encode_number(found.span_s),
        **{
            resource.used_key: encode_number(found.used[resource.name])
            for resource in RESOURCES
            if resource.name in found.used
        },
        spec_hash=found.spec_hash or None,
    )


def _encode_placement(placement: Placement) -> Document:
    return {
        "host": placement.host,
        "since": format_instant(placement.since),
        "spec_hash": placement.spec_hash,
        "generation": placement.generation,
    }


def decode(raw: object) -> ManagerState:
    """The memory in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "memory")
    memory = decode_nested(reader)
    check_no_faults(reader, "memory")
    return memory


def decode_nested(reader: DocumentReader) -> ManagerState:
    """The memory in an object of a larger document; mistakes go to the reader."""
    return ManagerState(
        managed=reader.flag("managed", default=False),
        placements={task: _decode_placement(inner) for task, inner in reader.children("placements")},
        first=reader.mapping("first", DocumentReader.text),
        cordons=frozenset(reader.texts("cordons")),
        draining=frozenset(reader.texts("draining")),
        done=reader.mapping("done", DocumentReader.text),
        downtimes={
            (inner.text("task"), inner.text("host")): inner.numbers("seconds")
            for inner in reader.items("downtimes")
        },
        stays=reader.mapping("stays", DocumentReader.numbers),
        contact=reader.mapping("contact", DocumentReader.instant),
        fenced=frozenset(reader.texts("fenced")),
        deferred=reader.mapping("deferred", DocumentReader.text),
        measured={
            (inner.text("task"), inner.text("class")): _decode_measured_demand(inner)
            for inner in reader.items("measured")
        },
    )


def _decode_measured_demand(reader: DocumentReader) -> MeasuredDemand:
    return MeasuredDemand(
        samples=reader.integer("samples"),
        span_s=reader.number("span_s"),
        used={
            resource.name: reader.number(resource.used_key)
            for resource in RESOURCES
            if not _may_be_unknown(resource) or reader.has(resource.used_key)
        },
        spec_hash=reader.text("spec_hash", ""),
    )


def _may_be_unknown(resource: Resource) -> bool:
    return resource.per_link or resource.declared_only


def _decode_placement(reader: DocumentReader) -> Placement:
    return Placement(
        host=reader.text("host"),
        since=reader.instant("since"),
        spec_hash=reader.text("spec_hash", ""),
        generation=reader.integer("generation", 0),
    )
