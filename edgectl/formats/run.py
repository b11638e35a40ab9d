"""Runs of experiments, and their trials, to and from JSON (docs/reference/files.md). Series stand as columns, rounded to what they mean."""

from collections.abc import Iterable, Mapping, Sequence

from edgectl.formats.base import FORMAT_VERSION, Document, number, optional, without_none
from edgectl.formats.plan import encode_policy, read_policy
from edgectl.formats.reader import Reader, close_document, open_document
from edgectl.model.evidence import Variant
from edgectl.model.experiment import Experiment, Handoff, Load, Machine, MapPair, Reading, Run, Span, Summary, Trial
from edgectl.model.inventory import Role
from edgectl.units import format_instant

# Decimals: of seconds, cores and similarities.
_MS, _CORES, _SSIM = 3, 4, 6


def encode(run: Run) -> Document:
    """The whole run; ``trials`` is left out where there are none."""
    return {
        "format_version": FORMAT_VERSION,
        "digest": run.digest,
        "experiment": _experiment(run.experiment),
        "machines": {name: _machine(machine) for name, machine in run.machines.items()},
    } | without_none(trials=[encode_trial(trial) for trial in run.trials] or None)


def _experiment(experiment: Experiment) -> Document:
    return {
        "name": experiment.name,
        "schemes": [{"name": variant.name, **encode_policy(variant.policy)} for variant in experiment.variants],
        "until": list(experiment.until),
        "repetitions": experiment.repetitions,
        "every_s": number(experiment.every),
        "limit_s": number(experiment.limit),
        "idle": number(experiment.idle),
        "metrics": {name: summary.value for name, summary in experiment.metrics.items()},
        "maps": {column: {"task": pair.task, "file": pair.file, "truth": pair.truth} for column, pair in experiment.maps.items()},
    }


def _machine(machine: Machine) -> Document:
    return {"role": machine.role.value, "cores": number(machine.cores), "memory_bytes": number(machine.memory)}


def encode_trial(trial: Trial) -> Document:
    """One trial, a document of its own."""
    return {
        "format_version": FORMAT_VERSION,
        "scheme": trial.scheme,
        "repetition": trial.repetition,
        "began_at": format_instant(trial.began_at),
        "latency_s": _rounded(trial.latency),
        "finished": trial.finished,
        "unplaced": trial.unplaced,
        "completed_s": {task: _rounded(at) for task, at in trial.completed.items()},
        "spans": [_span(span) for span in trial.spans],
        "handoffs": [_handoff(handoff) for handoff in trial.handoffs],
        "loads": {host: _loads(loads) for host, loads in trial.loads.items()},
        "readings": {name: {task: _readings(found) for task, found in tasks.items()} for name, tasks in trial.readings.items()},
        "ssim": {column: _rounded(value, _SSIM) for column, value in trial.ssim.items()},
    }


def _span(span: Span) -> Document:
    return {"task": span.task, "host": span.host, "start_s": _rounded(span.start), "end_s": _rounded(span.end)}


def _handoff(handoff: Handoff) -> Document:
    return {
        "task": handoff.task,
        "source": handoff.source,
        "target": handoff.target,
        "at_s": _rounded(handoff.at),
        "downtime_s": optional(None if handoff.downtime is None else round(handoff.downtime, _MS)),
    }


def _loads(loads: Sequence[Load]) -> Document:
    return {
        "at_s": [_rounded(load.at) for load in loads],
        "cores": [_rounded(load.cores, _CORES) for load in loads],
        "bytes": [round(load.memory) for load in loads],
        "bytes_per_s": [round(load.bytes_per_s) for load in loads],
    }


def _readings(readings: Sequence[Reading]) -> Document:
    return {"at_s": [_rounded(reading.at) for reading in readings], "value": [_figures(reading.value) for reading in readings]}


def _rounded(value: float, decimals: int = _MS) -> int | float:
    return number(round(value, decimals))


def _figures(value: float) -> int | float:
    """Six significant figures: what an application says may be of any size."""
    return number(float(f"{value:.6g}"))


def decode(raw: object) -> Run:
    """The run in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "run")
    reader.require("machines")
    run = Run(
        experiment=_read_experiment(reader.child("experiment")),
        digest=reader.text("digest"),
        machines={name: _read_machine(machine) for name, machine in reader.children("machines")},
        trials=tuple(_read_trial(trial) for trial in reader.items("trials")),
    )
    close_document(reader, "run")
    return run


def _read_experiment(reader: Reader) -> Experiment:
    return Experiment(
        name=reader.text("name"),
        variants=tuple(Variant(name=scheme.text("name"), policy=read_policy(scheme)) for scheme in reader.items("schemes")),
        until=reader.texts("until"),
        repetitions=reader.integer("repetitions", minimum=1),
        every=reader.number("every_s", positive=True),
        limit=reader.number("limit_s", positive=True),
        idle=reader.number("idle"),
        metrics=reader.mapping("metrics", lambda metrics, name: metrics.choice(name, Summary)),
        maps={
            column: MapPair(task=pair.text("task"), file=pair.text("file"), truth=pair.text("truth"))
            for column, pair in reader.children("maps")
        },
    )


def _read_machine(reader: Reader) -> Machine:
    return Machine(
        role=reader.choice("role", Role),
        cores=reader.number("cores", positive=True),
        memory=reader.number("memory_bytes", positive=True),
    )


def decode_trial(raw: object) -> Trial:
    """The trial in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "trial")
    trial = _read_trial(reader)
    close_document(reader, "trial")
    return trial


def _read_trial(reader: Reader) -> Trial:
    return Trial(
        scheme=reader.text("scheme"),
        repetition=reader.integer("repetition", minimum=1),
        began_at=reader.instant("began_at"),
        latency=reader.number("latency_s"),
        finished=reader.flag("finished"),
        unplaced=reader.integer("unplaced"),
        completed=reader.mapping("completed_s", Reader.number),
        spans=tuple(
            Span(task=span.text("task"), host=span.text("host"), start=span.number("start_s"), end=span.number("end_s"))
            for span in reader.items("spans")
        ),
        handoffs=tuple(_read_handoff(handoff) for handoff in reader.items("handoffs")),
        loads={host: tuple(_read_loads(loads)) for host, loads in reader.children("loads")},
        readings={
            name: {task: tuple(_read_readings(tasks.child(task))) for task in tasks.value} for name, tasks in reader.children("readings")
        },
        ssim=reader.mapping("ssim", lambda found, column: found.number(column, minimum=None)),
    )


def _read_handoff(reader: Reader) -> Handoff:
    return Handoff(
        task=reader.text("task"),
        source=reader.text("source"),
        target=reader.text("target"),
        at=reader.number("at_s"),
        downtime=reader.maybe_number("downtime_s"),
    )


def _read_loads(reader: Reader) -> Iterable[Load]:
    columns = _columns(reader, {"at_s": 0.0, "cores": 0.0, "bytes": 0.0, "bytes_per_s": 0.0})
    return (Load(at=at, cores=cores, memory=memory, bytes_per_s=rate) for at, cores, memory, rate in columns)


def _read_readings(reader: Reader) -> Iterable[Reading]:
    return (Reading(at=at, value=value) for at, value in _columns(reader, {"at_s": 0.0, "value": None}))


def _columns(reader: Reader, minima: Mapping[str, float | None]) -> Iterable[tuple[float, ...]]:
    """The rows of columns that are equally long."""
    columns = [reader.numbers(key, minimum=minimum) if reader.require(key) else () for key, minimum in minima.items()]
    if len({len(column) for column in columns}) > 1:
        reader.fault(None, f"{', '.join(minima)} must be equally long")
    return zip(*columns, strict=False)
