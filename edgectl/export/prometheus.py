# SPDX-License-Identifier: Apache-2.0
"""Metrics in Prometheus' text formats, as a page and over HTTP (with prometheus_client)."""

import contextlib
import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from http import HTTPStatus
from http.server import ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from prometheus_client import MetricsHandler, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from edgectl.errors import EdgectlError
from edgectl.export import metrics
from edgectl.export.metric_samples import Histogram, MetricsInput
from edgectl.export.metrics import METRICS, MetricType

# Of a request until it is complete, and of its answer once it is made.
REQUEST_TIMEOUT_S = 10.0
# Connections at once, and of these from one address.
MAX_CONNECTIONS, MAX_PER_PEER = 64, 16


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
    kind = _BoundedServerIPv6 if ":" in address[0] else _BoundedServer
    return kind(
        address,
        type("_Bound", (_MetricsRequestHandler,), {"look": staticmethod(look), "warn": staticmethod(warn)}),
    )


class _BoundedServer(ThreadingHTTPServer):
    """One thread per connection, up to a maximum in all and for one address; further ones are closed."""

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[MetricsHandler]) -> None:
        self._peers: Counter[str] = Counter()
        self._guard = threading.Lock()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer in a thread if the maximum is not reached."""
        with self._guard:
            peer = client_address[0]
            free = self._peers.total() < MAX_CONNECTIONS and self._peers[peer] < MAX_PER_PEER
            self._peers[peer] += free
        if free:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer, and release the thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._guard:
                self._peers[client_address[0]] -= 1
                self._peers += Counter()  # without the addresses that have none left

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a client that went away."""


class _BoundedServerIPv6(_BoundedServer):
    address_family = socket.AF_INET6


def hang_up_socket(line: socket.socket) -> None:
    """End a connection at once, which wakes the thread that reads it."""
    with contextlib.suppress(OSError):
        line.shutdown(socket.SHUT_RDWR)


class _MetricsRequestHandler(MetricsHandler):
    """One request."""

    timeout = REQUEST_TIMEOUT_S
    look: Callable[[], MetricsInput]
    warn: Callable[[str], None]

    def setup(self) -> None:
        """Begin the deadline of the request: a byte now and then does not prolong it."""
        super().setup()
        self._limit_time()

    def finish(self) -> None:
        """End the deadline."""
        self._timer.cancel()
        super().finish()

    def _limit_time(self) -> None:
        self._timer = threading.Timer(self.timeout, hang_up_socket, (self.connection,))
        self._timer.daemon = True
        self._timer.start()

    def do_GET(self) -> None:  # noqa: N802, the name that http.server calls
        """Answer ``/metrics``; every other path is 404."""
        if urlsplit(self.path).path != "/metrics":
            self.send_error(HTTPStatus.NOT_FOUND, "metrics are at /metrics")
            return
        self._timer.cancel()
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
        self._limit_time()
        super().do_GET()
