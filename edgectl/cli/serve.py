# SPDX-License-Identifier: Apache-2.0
"""serve command."""

import os
import secrets
import threading
from pathlib import Path
from stat import S_IMODE
from typing import Annotated

from typer import Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_inputs, save_file
from edgectl.errors import FileError, UsageError

_TOKEN_BYTES = 24
_MAX_TOKEN_FILE_BYTES = 4096


def serve_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    listen: Annotated[
        str, Option("--listen", metavar="[HOST:]PORT", help="Address; default HOST: 127.0.0.1.")
    ] = "9816",
    token_file: Annotated[
        Path | None,
        Option("--token-file", metavar="FILE", help="Ask for its token; created if missing (0600)."),
    ] = None,
    every: Annotated[str, Option("--every", metavar="TIME", help="Time between probes.")] = "5s",
    timeout: options.TimeoutOption = "8s",
) -> None:
    """Serve a read-only page of the fleet: what needs attention, what runs where and why, what moved.

    It changes nothing and takes no lock. Without a viewer for a minute, no host is probed. Other machines
    are served only with --token-file.

    Examples:
        edgectl serve
        edgectl serve --listen 9900 --every 2s
        edgectl serve --listen 127.0.0.1:9817 --token-file serve.token
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.cli.http_server import parse_listen_address, serve_http
    from edgectl.cli.signals import parse_every_option
    from edgectl.gateway.host_probe import ProbeOptions
    from edgectl.usecases.event_delivery import list_file_secrets
    from edgectl.usecases.scrape import RevisionCache, keep_sessions_open
    from edgectl.web.access import is_loopback_address
    from edgectl.web.feed import FleetFeed
    from edgectl.web.picture import build_page_document, collect_picture
    from edgectl.web.server import bind_page_server

    host, port = parse_listen_address(listen)
    if token_file is None and not is_loopback_address(host):
        raise UsageError(
            f"--listen {listen}: other machines are served only with a token",
            hint=f"add --token-file FILE, or listen on 127.0.0.1:{port} and forward it from there: "
            f"ssh -L {port}:127.0.0.1:{port} MANAGER",
        )
    period = parse_every_option(every)
    how = ProbeOptions(timeout=parse_duration_option(timeout, "--timeout"))
    fleet = build_fleet(load_inputs(inventory, tasks), asking=False)
    token = load_or_make_token(token_file) if token_file is not None else None
    with keep_sessions_open(fleet) as near:
        hidden = (*list_file_secrets(near), *([token] if token is not None else []))
        past = RevisionCache(near)
        feed = FleetFeed(lambda: build_page_document(collect_picture(near, how, past), hidden), every=period)
        threading.Thread(target=feed.run, daemon=True).start()
        try:
            serve_http(lambda address: bind_page_server(address, feed, token), listen, "/")
        finally:
            feed.stop()


def load_or_make_token(path: Path) -> str:
    """The token in ``path``; a new one is written where there is no such file.

    Raises:
        FileError: it cannot be read or written, or other users may read it.
        UsageError: it holds no token.
    """
    from edgectl.web.access import MIN_TOKEN_LENGTH, is_token

    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except FileNotFoundError:
        return _make_token(path)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror}") from error
    try:
        mode = S_IMODE(os.fstat(descriptor).st_mode)
        data = os.read(descriptor, _MAX_TOKEN_FILE_BYTES)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror}") from error
    finally:
        os.close(descriptor)
    if mode & 0o077:
        raise FileError(f"{path}: other users may read the token (mode {mode:04o})", hint=f"chmod 600 {path}")
    text = data.decode("utf-8", "replace").strip()
    if not is_token(text):
        raise UsageError(
            f"{path} holds no token: write {MIN_TOKEN_LENGTH} to 256 letters, digits or . _ ~ -",
            hint="remove the file, and a new token is made",
        )
    return text


def _make_token(path: Path) -> str:
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    save_file(path, token + "\n")
    console.print_message(f"wrote a new token to {path}")
    return token
