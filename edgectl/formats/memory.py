"""Memory to and from JSON: part of a snapshot, and the manager's own cache file."""

from edgectl.formats.base import FORMAT_VERSION, Document, number, without_none
from edgectl.formats.reader import Reader, close_document, open_document
from edgectl.model.memory import MeasuredDemand, Memory, Placement
from edgectl.units import format_instant


def encode(memory: Memory) -> Document:
    """The JSON form; sets are sorted."""
    return {
        "format_version": FORMAT_VERSION,
        "managed": memory.managed,
        "placements": {task: _placement(placement) for task, placement in memory.placements.items()},
        "first": dict(memory.first),
        "cordons": sorted(memory.cordons),
        "draining": sorted(memory.draining),
        "done": dict(memory.done),
        "downtimes": [
            {"task": task, "host": host, "seconds": [number(value) for value in values]}
            for (task, host), values in memory.downtimes.items()
        ],
        "stays": {task: [number(value) for value in values] for task, values in memory.stays.items()},
        "contact": {host: format_instant(at) for host, at in memory.contact.items()},
        "fenced": sorted(memory.fenced),
        "deferred": dict(memory.deferred),
        "measured": [{"task": task, "class": kind} | _measured(found) for (task, kind), found in sorted(memory.measured.items())],
    }


def _measured(found: MeasuredDemand) -> Document:
    return without_none(
        samples=found.samples,
        span_s=number(found.span_s),
        used_cores=number(found.cpu),
        used_bytes=number(found.memory),
        used_bytes_per_s=None if found.throughput is None else number(found.throughput),
        spec_hash=found.spec_hash or None,
    )


def _placement(placement: Placement) -> Document:
    return {
        "host": placement.host,
        "since": format_instant(placement.since),
        "spec_hash": placement.spec_hash,
        "generation": placement.generation,
    }


def decode(raw: object) -> Memory:
    """The memory in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "memory")
    memory = read(reader)
    close_document(reader, "memory")
    return memory


def read(reader: Reader) -> Memory:
    """The memory in an object of a larger document; mistakes go to the reader."""
    return Memory(
        managed=reader.flag("managed", default=False),
        placements={task: _read_placement(inner) for task, inner in reader.children("placements")},
        first=reader.mapping("first", Reader.text),
        cordons=frozenset(reader.texts("cordons")),
        draining=frozenset(reader.texts("draining")),
        done=reader.mapping("done", Reader.text),
        downtimes={(inner.text("task"), inner.text("host")): inner.numbers("seconds") for inner in reader.items("downtimes")},
        stays=reader.mapping("stays", Reader.numbers),
        contact=reader.mapping("contact", Reader.instant),
        fenced=frozenset(reader.texts("fenced")),
        deferred=reader.mapping("deferred", Reader.text),
        measured={(inner.text("task"), inner.text("class")): _read_measured(inner) for inner in reader.items("measured")},
    )


def _read_measured(reader: Reader) -> MeasuredDemand:
    return MeasuredDemand(
        samples=reader.integer("samples"),
        span_s=reader.number("span_s"),
        cpu=reader.number("used_cores"),
        memory=reader.number("used_bytes"),
        throughput=reader.maybe_number("used_bytes_per_s"),
        spec_hash=reader.text("spec_hash", ""),
    )


def _read_placement(reader: Reader) -> Placement:
    return Placement(
        host=reader.text("host"),
        since=reader.instant("since"),
        spec_hash=reader.text("spec_hash", ""),
        generation=reader.integer("generation", 0),
    )
