"""JSON of experiment runs and trials (docs/reference/files.md).

Time series are written as columns and rounded.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HandoffRecord,
    HostCapacity,
    LoadSample,
    MapPair,
    MetricAggregation,
    MetricReading,
    PlacementInterval,
    Trial,
)
from edgectl.experiments.model.schemes import Scheme
from edgectl.formats.digest import hash_value
from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, encode_optional, without_none
from edgectl.formats.document_reader import DocumentReader, check_no_faults, open_document
from edgectl.formats.plan import decode_policy, encode_policy
from edgectl.model.inventory import Inventory, Role
from edgectl.model.task import Tasks
from edgectl.units import format_instant

# Decimals written.
_SECONDS_DECIMALS, _CORES_DECIMALS, _SSIM_DECIMALS = 3, 4, 6


def digest_experiment(experiment: Experiment, inventory: Inventory, tasks: Tasks) -> str:
    """SHA-256 of everything that affects a trial: fleet, tasks and the conditions of a trial.

    Name, schemes, repetitions and metrics are left out: a run can be resumed after they change.
    """
    conditions = replace(experiment, name="", schemes=(), repetitions=1, metrics={})
    return "sha256:" + hash_value(
        {"experiment": conditions, "inventory": inventory.digest, "tasks": tasks.digest}
    )


def encode_run(run: ExperimentRun) -> Document:
    """The run document; without the key ``trials`` if there are none."""
    return {
        "format_version": FORMAT_VERSION,
        "digest": run.digest,
        "experiment": _encode_experiment(run.experiment),
        "machines": {name: _encode_host_capacity(machine) for name, machine in run.machines.items()},
    } | without_none(trials=[encode_trial(trial) for trial in run.trials] or None)


def _encode_experiment(experiment: Experiment) -> Document:
    return {
        "name": experiment.name,
        "schemes": [{"name": scheme.name, **encode_policy(scheme.policy)} for scheme in experiment.schemes],
        "until": list(experiment.until),
        "repetitions": experiment.repetitions,
        "every_s": encode_number(experiment.every),
        "limit_s": encode_number(experiment.limit),
        "idle": encode_number(experiment.idle),
        "metrics": {name: aggregation.value for name, aggregation in experiment.metrics.items()},
        "maps": {
            column: {"task": pair.task, "file": pair.file, "truth": pair.truth}
            for column, pair in experiment.maps.items()
        },
    }


def _encode_host_capacity(machine: HostCapacity) -> Document:
    return {
        "role": machine.role.value,
        "cores": encode_number(machine.cores),
        "memory_bytes": encode_number(machine.memory),
    }


def encode_trial(trial: Trial) -> Document:
    """The trial document."""
    return {
        "format_version": FORMAT_VERSION,
        "scheme": trial.scheme,
        "repetition": trial.repetition,
        "began_at": format_instant(trial.began_at),
        "latency_s": _encode_rounded(trial.latency),
        "finished": trial.finished,
        "unplaced": trial.unplaced,
        "completed_s": {task: _encode_rounded(at) for task, at in trial.completed.items()},
        "spans": [_encode_interval(span) for span in trial.spans],
        "handoffs": [_encode_handoff(handoff) for handoff in trial.handoffs],
        "loads": {host: _encode_loads(loads) for host, loads in trial.loads.items()},
        "readings": {
            name: {task: _encode_readings(found) for task, found in tasks.items()}
            for name, tasks in trial.readings.items()
        },
        "ssim": {column: _encode_rounded(value, _SSIM_DECIMALS) for column, value in trial.ssim.items()},
    }


def _encode_interval(span: PlacementInterval) -> Document:
    return {
        "task": span.task,
        "host": span.host,
        "start_s": _encode_rounded(span.start),
        "end_s": _encode_rounded(span.end),
    }


def _encode_handoff(handoff: HandoffRecord) -> Document:
    return {
        "task": handoff.task,
        "source": handoff.source,
        "target": handoff.target,
        "at_s": _encode_rounded(handoff.at),
        "downtime_s": encode_optional(
            None if handoff.downtime is None else round(handoff.downtime, _SECONDS_DECIMALS)
        ),
    }


def _encode_loads(loads: Sequence[LoadSample]) -> Document:
    return {
        "at_s": [_encode_rounded(load.at) for load in loads],
        "cores": [_encode_rounded(load.cores, _CORES_DECIMALS) for load in loads],
        "bytes": [round(load.memory) for load in loads],
        "bytes_per_s": [round(load.bytes_per_s) for load in loads],
    }


def _encode_readings(readings: Sequence[MetricReading]) -> Document:
    return {
        "at_s": [_encode_rounded(reading.at) for reading in readings],
        "value": [_encode_six_digits(reading.value) for reading in readings],
    }


def _encode_rounded(value: float, decimals: int = _SECONDS_DECIMALS) -> int | float:
    return encode_number(round(value, decimals))


def _encode_six_digits(value: float) -> int | float:
    """Six significant digits: an application's metric may have any magnitude."""
    return encode_number(float(f"{value:.6g}"))


def decode_run(raw: object) -> ExperimentRun:
    """The run in a JSON document.

    Raises:
        FormatErrors: all faults of the document.
    """
    reader = open_document(raw, "run")
    reader.require("machines")
    run = ExperimentRun(
        experiment=_decode_experiment(reader.child("experiment")),
        digest=reader.text("digest"),
        machines={name: _decode_host_capacity(machine) for name, machine in reader.children("machines")},
        trials=tuple(_decode_trial_fields(trial) for trial in reader.items("trials")),
    )
    check_no_faults(reader, "run")
    return run


def _decode_experiment(reader: DocumentReader) -> Experiment:
    return Experiment(
        name=reader.text("name"),
        schemes=tuple(
            Scheme(name=scheme.text("name"), policy=decode_policy(scheme))
            for scheme in reader.items("schemes")
        ),
        until=reader.texts("until"),
        repetitions=reader.integer("repetitions", minimum=1),
        every=reader.number("every_s", positive=True),
        limit=reader.number("limit_s", positive=True),
        idle=reader.number("idle"),
        metrics=reader.mapping("metrics", lambda metrics, name: metrics.choice(name, MetricAggregation)),
        maps={
            column: MapPair(task=pair.text("task"), file=pair.text("file"), truth=pair.text("truth"))
            for column, pair in reader.children("maps")
        },
    )


def _decode_host_capacity(reader: DocumentReader) -> HostCapacity:
    return HostCapacity(
        role=reader.choice("role", Role),
        cores=reader.number("cores", positive=True),
        memory=reader.number("memory_bytes", positive=True),
    )


def decode_trial(raw: object) -> Trial:
    """The trial in a JSON document.

    Raises:
        FormatErrors: all faults of the document.
    """
    reader = open_document(raw, "trial")
    trial = _decode_trial_fields(reader)
    check_no_faults(reader, "trial")
    return trial


def _decode_trial_fields(reader: DocumentReader) -> Trial:
    return Trial(
        scheme=reader.text("scheme"),
        repetition=reader.integer("repetition", minimum=1),
        began_at=reader.instant("began_at"),
        latency=reader.number("latency_s"),
        finished=reader.flag("finished"),
        unplaced=reader.integer("unplaced"),
        completed=reader.mapping("completed_s", DocumentReader.number),
        spans=tuple(
            PlacementInterval(
                task=span.text("task"),
                host=span.text("host"),
                start=span.number("start_s"),
                end=span.number("end_s"),
            )
            for span in reader.items("spans")
        ),
        handoffs=tuple(_decode_handoff(handoff) for handoff in reader.items("handoffs")),
        loads={host: tuple(_decode_loads(loads)) for host, loads in reader.children("loads")},
        readings={
            name: {task: tuple(_decode_readings(tasks.child(task))) for task in tasks.value}
            for name, tasks in reader.children("readings")
        },
        ssim=reader.mapping("ssim", lambda found, column: found.number(column, minimum=None)),
    )


def _decode_handoff(reader: DocumentReader) -> HandoffRecord:
    return HandoffRecord(
        task=reader.text("task"),
        source=reader.text("source"),
        target=reader.text("target"),
        at=reader.number("at_s"),
        downtime=reader.maybe_number("downtime_s"),
    )


def _decode_loads(reader: DocumentReader) -> Iterable[LoadSample]:
    columns = _decode_columns(reader, {"at_s": 0.0, "cores": 0.0, "bytes": 0.0, "bytes_per_s": 0.0})
    return (
        LoadSample(at=at, cores=cores, memory=memory, bytes_per_s=rate) for at, cores, memory, rate in columns
    )


def _decode_readings(reader: DocumentReader) -> Iterable[MetricReading]:
    return (
        MetricReading(at=at, value=value)
        for at, value in _decode_columns(reader, {"at_s": 0.0, "value": None})
    )


def _decode_columns(
    reader: DocumentReader, minima: Mapping[str, float | None]
) -> Iterable[tuple[float, ...]]:
    """The rows of columns of equal length."""
    columns = [
        reader.numbers(key, minimum=minimum) if reader.require(key) else () for key, minimum in minima.items()
    ]
    if len({len(column) for column in columns}) > 1:
        reader.fault(None, f"{', '.join(minima)} must have the same length")
    return zip(*columns, strict=False)
