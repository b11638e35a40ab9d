# SPDX-License-Identifier: Apache-2.0
"""HTTP servers of export prometheus and serve."""

from collections.abc import Callable
from http.server import ThreadingHTTPServer

from edgectl.cli import console
from edgectl.cli.signals import return_on_signal
from edgectl.errors import EdgectlError, UsageError

_LOOPBACK = "127.0.0.1"
_MAX_PORT = 65535


def serve_http(make: Callable[[tuple[str, int]], ThreadingHTTPServer], where: str, path: str) -> None:
    """Serve at the address ``where`` until SIGINT or SIGTERM, which end it with exit code 0.

    ``path``: where the address that is printed leads to.

    Raises:
        UsageError: ``where`` is not an address.
        EdgectlError: the address cannot be bound.
    """
    address = parse_listen_address(where)
    try:
        server = make(address)
    except OSError as error:
        raise EdgectlError(
            f"cannot listen on {where}: {error.strerror}",
            hint="choose an address of this machine and a free port",
        ) from error
    with server, return_on_signal():
        host = f"[{address[0]}]" if ":" in address[0] else address[0]
        console.print_message(f"serving http://{host}:{server.server_port}{path}; press Ctrl-C to stop")
        server.serve_forever()


def parse_listen_address(text: str) -> tuple[str, int]:
    """Parse ``HOST:PORT``, ``[HOST]:PORT`` or ``PORT``; without a host only this machine is served.

    Raises:
        UsageError: it is none of these.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) <= _MAX_PORT):
        raise UsageError(
            f"--listen: cannot read the address {text!r}", hint="write 127.0.0.1:9815, [::1]:9815 or 9815"
        )
    return host.removeprefix("[").removesuffix("]") or _LOOPBACK, int(port)
