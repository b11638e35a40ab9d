"""Comparisons of policies, as text and as documents."""

from collections.abc import Iterable, Sequence

from edgectl.formats.base import FORMAT_VERSION, Document, number
from edgectl.model.evidence import Figure, Replayed, Share, Simulated
from edgectl.model.scenario import Scenario
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, flowed

_OPEN_LOOP = (
    "Open loop: what tasks used and how long they ran is as recorded, whatever a variant decided; "
    "edgectl simulate closes the loop in a model."
)


def replayed_text(values: Iterable[Replayed], look: Look = PLAIN) -> str:
    """One line per variant; utilisations as mean and peak over edges (or links) and cycles."""
    found = list(values)
    cycles = max((value.cycles for value in found), default=0)
    rows: list[Row] = [("VARIANT", "HANDOFFS", "PER CYCLE", "UNPLACED", "CPU", "MEMORY", "NETWORK")]
    rows += [
        (
            Cell(value.variant.name, "name"),
            str(value.handoffs),
            _per_cycle(value),
            str(value.unplaced),
            *(_share(share) if value.cycles else "-" for share in _shares(value)),
        )
        for value in found
    ]
    text = columns(rows, look, right={1, 2, 3, 4, 5, 6})
    return text + flowed(f"{cycles} cycles; utilisation as mean/peak. {_OPEN_LOOP}", look)


def _per_cycle(value: Replayed) -> str:
    return f"{value.handoffs / value.cycles:.3f}" if value.cycles else "-"


def _shares(value: Replayed) -> tuple[Share, Share, Share]:
    return value.cpu, value.memory, value.network


def _share(value: Share) -> str:
    return f"{value.mean:.0%}/{value.peak:.0%}"


def replayed_document(values: Iterable[Replayed]) -> Document:
    """The same numbers as JSON types; utilisations are shares of the capacity."""
    return {"format_version": FORMAT_VERSION, "open_loop": True, "variants": [_replayed(value) for value in values]}


def _replayed(value: Replayed) -> Document:
    policy = value.variant.policy
    return {
        "name": value.variant.name,
        "policy": policy.name.value,
        "move_margin": number(policy.move_margin),
        "cycles": value.cycles,
        "handoffs": value.handoffs,
        "unplaced": value.unplaced,
        "unsettled": value.unsettled,
        **{name: {"mean": number(share.mean), "peak": number(share.peak)} for name, share in zip(_NAMES, _shares(value), strict=True)},
    }


_NAMES = ("cpu", "memory", "network")


def simulated_text(scenario: Scenario, values: Iterable[Simulated], look: Look = PLAIN, *, every: bool = False) -> str:
    """One line per scheme, with what was published of it and how far the model is off below; then every assumption."""
    found = list(values)
    metrics = _EVERY if every else _MAIN
    rows: list[Row] = [("SCHEME", *(_HEADS[metric] for metric in metrics))]
    for value in found:
        known = scenario.published.get(value.variant.name, {})
        rows.append((Cell(value.variant.name, "name"), *(_figures(value, metric, every=every) for metric in metrics)))
        if known:
            rows.append((Cell("  published", "dim"), *(_plain(metric, known.get(metric, ())) for metric in metrics)))
            rows.append((Cell("  off by", "dim"), *(_off(value, metric, known.get(metric, ())) for metric in metrics)))
    runs = max((value.runs for value in found), default=0)
    text = columns(rows, look, right=range(1, len(metrics) + 1))
    lines = [f"{runs} runs of each scheme; mean±deviation of the latency, means of the rest, by edge (local: of the robots)."]
    lines += [f"{value.variant.name}: runs given up at the limit: {value.unfinished}" for value in found if value.unfinished]
    lines += _ratios(scenario, found)
    lines += ["Assumptions, the same for every scheme:", *(f"- {line}" for line in scenario.assumptions)]
    return text + "\n" + "".join(flowed(line, look) for line in lines)


_MAIN = ("latency", "cpu", "memory", "rate", "handoffs")
_EVERY = ("latency", "cpu", "cpu peak", "memory", "throughput", "rate", "handoffs")
_HEADS = {
    "latency": "LATENCY min", "cpu": "CPU %", "cpu peak": "PEAK %", "memory": "MEMORY %", "throughput": "MB/s", "rate": "FRAMES/s",
    "handoffs": "HANDOFFS",
}  # fmt: skip
_DIGITS = {"latency": 2, "rate": 1, "throughput": 2, "handoffs": 1}


def _figures(value: Simulated, metric: str, *, every: bool) -> str:
    figures, digits = value.figures[metric], _DIGITS.get(metric, 0)
    spread = every or metric == "latency"
    return "/".join(f"{each.mean:.{digits}f}" + (f"±{each.std:.{digits}f}" if spread else "") for each in figures)


def _plain(metric: str, values: Sequence[float]) -> str:
    return "/".join(f"{value:.{_DIGITS.get(metric, 0)}f}" for value in values) or "-"


def _off(value: Simulated, metric: str, known: Sequence[float]) -> str:
    """The deviation of each mean from what was published."""
    figures = value.figures[metric]
    if len(figures) != len(known):
        return "-"
    return "/".join(_percent((each.mean - real) / real) if real else "-" for each, real in zip(figures, known, strict=True))


def _percent(share: float) -> str:
    """Signed whole percent; nothing is +0%."""
    return f"{round(100 * share) + 0:+d}%"


def _ratios(scenario: Scenario, found: Sequence[Simulated]) -> list[str]:
    """How the latencies stand to those of local and static execution, in the model and as published."""
    by_name = {value.variant.name: value for value in found}
    lines = []
    for base in ("local", "static"):
        if base in by_name:
            parts = [_ratio(scenario, value, by_name[base]) for value in found if value.variant.name not in ("local", base)]
            lines += [f"Latency as a share of {base} execution: {', '.join(parts)}."] if parts else []
    return lines


def _ratio(scenario: Scenario, value: Simulated, base: Simulated) -> str:
    text = f"{value.variant.name} {value.figures['latency'][0].mean / base.figures['latency'][0].mean:.2f}"
    known = [scenario.published.get(each.variant.name, {}).get("latency") for each in (value, base)]
    return text + (f" (published {known[0][0] / known[1][0]:.2f})" if known[0] and known[1] else "")


def simulated_document(scenario: Scenario, values: Iterable[Simulated]) -> Document:
    """Every figure as JSON types; ``published`` beside it where something was."""
    return {
        "format_version": FORMAT_VERSION,
        "scenario": scenario.name,
        "assumptions": list(scenario.assumptions),
        "schemes": [_simulated(scenario, value) for value in values],
    }


def _simulated(scenario: Scenario, value: Simulated) -> Document:
    known = scenario.published.get(value.variant.name, {})
    return {
        "name": value.variant.name,
        "runs": value.runs,
        "unfinished": value.unfinished,
        "unplaced": value.unplaced,
        "figures": {metric: [_figure(each) for each in figures] for metric, figures in value.figures.items()},
        "published": {metric: [number(each) for each in figures] for metric, figures in known.items()},
    }


def _figure(value: Figure) -> Document:
    return {"mean": number(value.mean), "std": number(value.std), "half_ci95": number(value.half)}
