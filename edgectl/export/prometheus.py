"""Metrics in Prometheus' text formats, as a page and over HTTP. The one module that imports prometheus_client."""

import socket
import threading
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
from edgectl.export.metrics import METRICS, Kind
from edgectl.export.readings import BUCKETS_S, Picture, Spread

# Of a client that connects and says nothing.
_IDLE_S = 10.0
# Connections at once.
MOST = 64


def text(picture: Picture) -> str:
    """The page that Prometheus, or node_exporter's textfile collector, reads."""
    return generate_latest(_Page(families(picture))).decode()


def families(picture: Picture) -> list[Metric]:
    """Every metric with its samples, in the words of prometheus_client."""
    return [_family(metric, picture) for metric in METRICS]


def _family(metric: metrics.Metric, picture: Picture) -> Metric:
    samples = metric.samples(picture)
    if metric.kind is Kind.HISTOGRAM:
        histogram = HistogramMetricFamily(metric.name, metric.help, labels=metric.labels)
        for labels, spread in samples:
            if isinstance(spread, Spread):
                histogram.add_metric(labels, list(_buckets(spread)), sum_value=spread.total)
        return histogram
    family = (CounterMetricFamily if metric.kind is Kind.COUNTER else GaugeMetricFamily)(metric.name, metric.help, labels=metric.labels)
    for labels, value in samples:
        if not isinstance(value, Spread):
            family.add_metric(labels, value)
    return family


def _buckets(spread: Spread) -> Iterator[tuple[str, float]]:
    yield from ((str(bound), count) for bound, count in zip(BUCKETS_S, spread.counts, strict=True))
    yield "+Inf", spread.count


class _Page(Collector):
    """Families that were made already."""

    def __init__(self, families: Iterable[Metric]) -> None:
        self._families = families

    def collect(self) -> Iterable[Metric]:
        return self._families


def server(address: tuple[str, int], look: Callable[[], Picture], warn: Callable[[str], None]) -> ThreadingHTTPServer:
    """A server, bound to ``address``, that answers ``/metrics`` with what ``look`` gives; ``look`` is called from many threads.

    Where ``look`` fails the answer is 503 with the reason, which ``warn`` hears, too.

    Raises:
        OSError: the address cannot be bound.
    """
    kind = _Server6 if ":" in address[0] else _Server
    return kind(address, type("_Bound", (_Answer,), {"look": staticmethod(look), "warn": staticmethod(warn)}))


class _Server(ThreadingHTTPServer):
    """One thread per connection, and so many at most: what comes beyond them is hung up on."""

    daemon_threads = True
    request_queue_size = MOST

    def __init__(self, address: tuple[str, int], handler: type[MetricsHandler]) -> None:
        self._free = threading.BoundedSemaphore(MOST)
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer in a thread of its own, where there is room for one."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer, and make room again."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a client that went away."""


class _Server6(_Server):
    address_family = socket.AF_INET6


class _Answer(MetricsHandler):
    """One request."""

    timeout = _IDLE_S
    look: Callable[[], Picture]
    warn: Callable[[str], None]

    def do_GET(self) -> None:  # noqa: N802, the name that http.server calls
        """Answer ``/metrics``; nothing else is here."""
        if urlsplit(self.path).path != "/metrics":
            self.send_error(HTTPStatus.NOT_FOUND, "metrics are at /metrics")
            return
        try:
            self.registry = _Page(families(self.look()))
        except Exception as error:  # one scrape, never the server
            reason = error.message if isinstance(error, EdgectlError) else f"unexpected {type(error).__name__}: {error}"
            self.warn(reason)
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "no metrics", reason)
            return
        super().do_GET()
