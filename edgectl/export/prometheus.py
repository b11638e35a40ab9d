# SPDX-License-Identifier: Apache-2.0
"""Metrics in Prometheus' text formats, as a page and over HTTP (with prometheus_client)."""

from collections.abc import Callable, Iterable, Iterator
from http import HTTPStatus
from http.server import ThreadingHTTPServer
from urllib.parse import urlsplit

from prometheus_client import MetricsHandler, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from edgectl.errors import EdgectlError
from edgectl.export import metrics
from edgectl.export.http_connections import BoundedServer, DeadlineRequestHandler
from edgectl.export.metric_samples import Histogram, MetricsInput
from edgectl.export.metrics import METRICS, MetricType


def render_metrics_page(picture: MetricsInput) -> str:
    """The page for Prometheus, or for node_exporter's textfile collector."""
    return generate_latest(_FamilyCollector(build_metric_families(picture))).decode()


def build_metric_families(picture: MetricsInput) -> list[Metric]:
    """All metrics with their samples as families of prometheus_client."""
    return [_build_metric_family(metric, picture) for metric in METRICS]


def _build_metric_family(metric: metrics.MetricDefinition, picture: MetricsInput) -> Metric:
    samples = metric.samples(picture)
    if metric.kind is MetricType.HISTOGRAM:
        histogram = HistogramMetricFamily(metric.name, metric.help, labels=metric.labels)
        for labels, spread in samples:
            if isinstance(spread, Histogram):
                histogram.add_metric(labels, list(_list_buckets(spread)), sum_value=spread.total)
        return histogram
    family = (CounterMetricFamily if metric.kind is MetricType.COUNTER else GaugeMetricFamily)(
        metric.name, metric.help, labels=metric.labels
    )
    for labels, value in samples:
        if not isinstance(value, Histogram):
            family.add_metric(labels, value)
    return family


def _list_buckets(spread: Histogram) -> Iterator[tuple[str, float]]:
    yield from ((str(bound), count) for bound, count in zip(spread.bounds, spread.counts, strict=True))
    yield "+Inf", spread.count


class _FamilyCollector(Collector):
    """A collector of given families."""

    def __init__(self, families: Iterable[Metric]) -> None:
        self._families = families

    def collect(self) -> Iterable[Metric]:
        return self._families


def bind_metrics_server(
    address: tuple[str, int], look: Callable[[], MetricsInput], warn: Callable[[str], None]
) -> ThreadingHTTPServer:
    """A server bound to ``address`` that answers ``/metrics`` with the result of ``look``, which is called
    from many threads.

    If ``look`` fails, the answer is 503 with the reason, which is passed to ``warn``, too.

    Raises:
        OSError: the address cannot be bound.
    """
    return BoundedServer(
        address,
        type("_Bound", (_MetricsRequestHandler,), {"look": staticmethod(look), "warn": staticmethod(warn)}),
    )


class _MetricsRequestHandler(DeadlineRequestHandler, MetricsHandler):
    """One request."""

    look: Callable[[], MetricsInput]
    warn: Callable[[str], None]

    def do_GET(self) -> None:  # noqa: N802, the name that http.server calls
        """Answer ``/metrics``; every other path is 404."""
        if urlsplit(self.path).path != "/metrics":
            self.send_error(HTTPStatus.NOT_FOUND, "metrics are at /metrics")
            return
        self.end_deadline()
        try:
            self.registry = _FamilyCollector(build_metric_families(self.look()))
        except Exception as error:  # an error ends one scrape, never the server
            reason = (
                error.message
                if isinstance(error, EdgectlError)
                else f"unexpected {type(error).__name__}: {error}"
            )
            self.warn(reason)
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "no metrics", reason)
            return
        self.begin_deadline()
        super().do_GET()
