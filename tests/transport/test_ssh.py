# SPDX-License-Identifier: Apache-2.0
"""Both SSH transports against real servers: same features, same errors."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from types import FrameType

import paramiko
import pytest
from paramiko.common import MSG_CHANNEL_SUCCESS

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError, ReplyError
from edgectl.model.inventory import Connection, Host
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import ConversableSession, Reply, RestingExchange, Transport
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.transport.sockets import ProxySocket, start_proxy_command
from edgectl.transport.ssh_client import order_key_exchanges
from tests.pace import patience
from tests.relay import RelayFault, run_mute_server, run_relay
from tests.sshd import Lab, make_key, running_lab
from tests.transport.test_conversation import until


@pytest.fixture(params=[Connection.SSH, Connection.OPENSSH])
def connection(request: pytest.FixtureRequest) -> Connection:
    return Connection(request.param)


@pytest.fixture
def transport() -> Transport:
    return FleetTransport()


def run_command(
    transport: Transport,
    host: Host,
    command: str = "echo here",
    stdin: bytes = b"",
    *,
    timeout: float = 10.0,
    limit: int = 1 << 20,
) -> Reply:
    with transport.connect(host, timeout=timeout) as session:
        return session.run(command, stdin, timeout=timeout, limit=limit)


# Bound for operations that end at once, on a busy machine; a hang takes longer.
BUSY_S = patience(15.0)


def measure_failure(
    transport: Transport, host: Host, command: str = "echo here", *, timeout: float = 10.0
) -> tuple[HostError, float]:
    """Return the error and its delay."""
    start = time.monotonic()
    with pytest.raises(HostError) as caught:
        run_command(transport, host, command, timeout=timeout)
    assert "\n" not in caught.value.message
    assert caught.value.host == host.name
    return caught.value, time.monotonic() - start


def test_bytes_go_in_and_out_unchanged(lab: Lab, transport: Transport, connection: Connection) -> None:
    data = bytes(range(256)) * 8000
    reply = run_command(
        transport, lab.host("edge1", connection=connection), "cat; echo oops >&2; exit 3", data, limit=4 << 20
    )
    assert (reply.stdout, reply.stderr, reply.status) == (data, b"oops\n", 3)


def test_an_exchange_that_rests_wakes_nobody_until_it_ends(lab: Lab, transport: Transport) -> None:
    """What came is there, with its time, for whoever looks; once it no longer rests, it wakes its reader."""
    session = transport.connect(lab.host("edge1"), timeout=BUSY_S)
    assert isinstance(session, ConversableSession)
    made = session.converse("cat", b"", timeout=BUSY_S, give_way=lambda: None)
    with session, closing(made) as exchange:
        assert isinstance(exchange, RestingExchange)
        exchange.rest(resting=True)
        for word in (b"one\n", b"two\n"):
            before = time.monotonic()
            exchange.write(word, timeout=BUSY_S)
            until(exchange.has_arrived)
            assert before < exchange.arrived_at <= time.monotonic()
            asleep = time.monotonic()
            exchange.await_arrival(0.05)
            assert time.monotonic() >= asleep + 0.05
            assert exchange.read(timeout=0.0) == word
            assert not exchange.has_arrived()
        exchange.write(b"three\n", timeout=BUSY_S)
        until(exchange.has_arrived)
        exchange.rest(resting=False)
        before = time.monotonic()
        exchange.await_arrival(BUSY_S)
        assert exchange.read(timeout=0.0) == b"three\n"
        exchange.rest(resting=True)
        exchange.wake()
        exchange.await_arrival(BUSY_S)
        with pytest.raises(DeadlineError):
            exchange.read(timeout=0.0)
        # Of this machine: the least that the kernel waits is 0.2 s.
        assert 0.2 <= (exchange.find_repeat_s() or 0.0) < 0.3
        exchange.finish(b"", timeout=BUSY_S)
        exchange.await_arrival(BUSY_S)
        assert exchange.read(timeout=0.0) == b""
        assert time.monotonic() < before + BUSY_S


def test_a_pulse_takes_few_calls(lab: Lab, transport: Transport) -> None:
    """In Python, of a look at the line, ten bytes over it, and another look; 49 before."""
    session = transport.connect(lab.host("edge1"), timeout=BUSY_S)
    assert isinstance(session, ConversableSession)
    calls = 0

    def note(_frame: FrameType, event: str, _what: object) -> None:
        nonlocal calls
        calls += event == "call"

    made = session.converse("cat > /dev/null", b"", timeout=BUSY_S, give_way=lambda: None)
    with session, closing(made) as exchange:
        assert isinstance(exchange, RestingExchange)
        until(exchange.can_write)
        exchange.write(b"pulse 0 0\n", timeout=BUSY_S)
        before = sys.getprofile()
        sys.setprofile(note)
        try:
            assert exchange.can_write()
            exchange.write(b"pulse 0 0\n", timeout=BUSY_S)
            assert exchange.find_repeat_s() is not None
        finally:
            sys.setprofile(before)
        exchange.finish(b"", timeout=BUSY_S)
    assert 15 < calls <= 36, calls


def test_each_server_is_a_host_of_its_own(lab: Lab, transport: Transport, connection: Connection) -> None:
    homes = [
        run_command(transport, lab.host(name, connection=connection), "echo $HOME").stdout.decode().strip()
        for name in lab.servers
    ]
    assert homes == [str(server.home) for server in lab.servers.values()]


def test_a_program_may_leave_its_input_unread(lab: Lab, transport: Transport, connection: Connection) -> None:
    assert (
        run_command(transport, lab.host("edge1", connection=connection), "exec true", b"x" * 3_000_000).status
        == 0
    )


def test_large_stderr_does_not_block(lab: Lab, transport: Transport, connection: Connection) -> None:
    reply = run_command(
        transport,
        lab.host("edge1", connection=connection),
        "head -c 5000000 /dev/zero >&2; echo end",
        limit=8 << 20,
    )
    assert (len(reply.stderr), reply.stdout) == (5_000_000, b"end\n")


def test_the_input_does_not_wait_until_the_server_agrees(
    lab: Lab, transport: Transport, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command and its input travel together as far as the server has room for it (`test_wire.py`)."""
    agreed, sent = threading.Event(), paramiko.Channel.sendall
    succeed = paramiko.Channel._request_success  # type: ignore[attr-defined]

    def agree_late(channel: paramiko.Channel, message: paramiko.Message) -> None:
        assert agreed.wait(BUSY_S), "the input waits for the server"
        succeed(channel, message)

    def note_input(channel: paramiko.Channel, data: bytes) -> None:
        sent(channel, data)
        agreed.set()

    monkeypatch.setitem(paramiko.Transport._channel_handler_table, MSG_CHANNEL_SUCCESS, agree_late)  # type: ignore[attr-defined]
    monkeypatch.setattr(paramiko.Channel, "sendall", note_input)
    assert run_command(transport, lab.host("edge1"), "cat", b"the input").stdout == b"the input"


CURVE25519, P256 = "curve25519-sha256@libssh.org", "ecdh-sha2-nistp256"
# OpenSSH has the hybrid from 9.9 on, and paramiko prefers it.
NO_HYBRID = "KexAlgorithms -mlkem*"


@pytest.mark.parametrize(
    ("sshd_config", "ssh_config", "agreed"),
    [
        ([NO_HYBRID], [], P256),
        ([f"KexAlgorithms {CURVE25519}"], [], CURVE25519),
        ([NO_HYBRID], [f"KexAlgorithms -{P256}"], CURVE25519),
        ([f"KexAlgorithms {P256}"], [f"KexAlgorithms -{P256}"], P256),
    ],
    ids=["usual", "the host lacks it", "ssh_config lacks it", "the host has nothing else"],
)
def test_p_256_is_agreed_on_unless_either_side_leaves_it_out(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    sshd_config: list[str],
    ssh_config: list[str],
    agreed: str,
) -> None:
    with running_lab(tmp_path / "lab", ["edge1"], extra=["LogLevel DEBUG", *sshd_config]) as one:
        one.write_files(*ssh_config)
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(one.ssh_config))
        FleetTransport().connect(one.host("edge1"), timeout=BUSY_S).close()
        assert f"kex: algorithm: {agreed} " in one["edge1"].log


def test_an_exchange_that_resists_quantum_computers_stays_first() -> None:
    known = ("mlkem768x25519-sha256", CURVE25519, "ecdh-sha2-nistp384", P256, "diffie-hellman-group16-sha512")
    assert order_key_exchanges(known, ()) == (known[0], P256, CURVE25519, known[2], known[4])
    assert order_key_exchanges(known, (CURVE25519, P256)) == order_key_exchanges(known, ())
    for allowed, others in (((CURVE25519,), known), ((), known[2:]), ((), known[:2])):
        assert order_key_exchanges(others, allowed) == others


def test_calls_wait_for_each_other_where_there_is_room_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As long as their deadlines allow, and no longer; the refusal says why."""
    with running_lab(tmp_path / "lab", ["edge1"], extra=["MaxSessions 1"]) as one:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(one.ssh_config))
        with (
            FleetTransport().connect(one.host("edge1"), timeout=BUSY_S) as session,
            ThreadPoolExecutor(5) as pool,
        ):
            # Longer than all pauses between the attempts of one call.
            asked = [pool.submit(session.run, f"sleep 1; echo {n}", b"", timeout=BUSY_S) for n in range(4)]
            assert [each.result().stdout for each in asked] == [b"%d\n" % n for n in range(4)]
            long = pool.submit(session.run, "sleep 4; echo long", b"", timeout=BUSY_S)
            time.sleep(1.0)
            with pytest.raises(ConnectError, match="refused to open a channel"):
                session.run("echo short", b"", timeout=1.5)
            assert long.result().stdout == b"long\n"


def test_output_is_capped(lab: Lab, transport: Transport, connection: Connection) -> None:
    with pytest.raises(ReplyError, match="more than 1048576 bytes"):
        run_command(
            transport,
            lab.host("edge1", connection=connection),
            "head -c 20000000 /dev/zero; sleep 30",
            timeout=20.0,
        )


def test_deadline_of_a_command(lab: Lab, transport: Transport, connection: Connection) -> None:
    error, seconds = measure_failure(
        transport, lab.host("edge1", connection=connection), "exec sleep 60", timeout=2.0
    )
    assert isinstance(error, DeadlineError)
    assert seconds < BUSY_S


def test_a_session_outlives_its_failures(lab: Lab, transport: Transport) -> None:
    with transport.connect(lab.host("edge1"), timeout=10) as session:
        with pytest.raises(ReplyError):
            session.run("head -c 20000000 /dev/zero", b"", timeout=20)
        with pytest.raises(DeadlineError):
            session.run("exec sleep 30", b"", timeout=0.3)
        assert session.run("echo still here", b"", timeout=20).stdout == b"still here\n"


def test_noise_of_the_login_shell_changes_no_reply(
    transport: Transport, connection: Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "banner").write_text("=== Authorised use only ===\n")
    with running_lab(tmp_path / "lab", ["edge1"], extra=[f"Banner {tmp_path / 'banner'}"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        (lab["edge1"].home / ".bashrc").write_text(
            "echo 'Welcome to the robot {\"v\": 1}'; printf '\\033[31m\\377\\n'; echo nonsense >&2\n"
        )
        reply = run_command(transport, lab.host("edge1", connection=connection), "echo here")
        with transport.connect(lab.host("edge1", connection=connection), timeout=10) as session:
            document = call_agent(
                session, {"op": "status", "fleet": "lab", "host": "edge1", "task": None}, timeout=10
            )
    assert reply.stdout.startswith(b"Welcome")
    assert reply.stdout.endswith(b"here\n")
    assert b"Authorised" not in reply.stdout
    assert document["tasks"] == {}


def test_a_restricted_key_is_enough(lab: Lab, transport: Transport, connection: Connection) -> None:
    """No terminal, no forwarding: ``restrict`` in authorized_keys disables nothing that edgectl uses."""
    before = lab.authorized_keys.read_text()
    lab.authorized_keys.write_text("restrict " + before)
    try:
        with transport.connect(lab.host("edge2", connection=connection), timeout=10) as session:
            assert (
                call_agent(
                    session, {"op": "status", "fleet": "lab", "host": "edge2", "task": None}, timeout=10
                )["tasks"]
                == {}
            )
    finally:
        lab.authorized_keys.write_text(before)


def test_output_comes_as_a_stream(
    lab: Lab, transport: Transport, connection: Connection, tmp_path: Path
) -> None:
    """The second line is sent only after the first was received."""
    heard = tmp_path / "heard"
    with transport.connect(lab.host("edge1", connection=connection), timeout=10) as session:
        pieces = session.stream(
            f"read a; echo first $a; until [ -e {heard} ]; do sleep 0.05; done; echo second",
            b"x\n",
            idle_timeout=20,
        )
        assert next(pieces) == b"first x\n"
        heard.touch()
        assert b"".join(pieces) == b"second\n"


def test_a_silent_stream_ends(lab: Lab, transport: Transport, connection: Connection) -> None:
    with transport.connect(lab.host("edge1", connection=connection), timeout=10) as session:
        pieces = session.stream("echo first; sleep 30", b"", idle_timeout=6.0)
        assert next(pieces) == b"first\n"
        with pytest.raises(DeadlineError):
            next(pieces)


def test_a_stream_can_be_left(lab: Lab, transport: Transport, connection: Connection) -> None:
    with transport.connect(lab.host("edge1", connection=connection), timeout=10) as session:
        pieces = session.stream("yes", b"", idle_timeout=20)
        assert next(pieces).startswith(b"y\n")
        assert isinstance(pieces, Iterator)
        pieces.close()  # type: ignore[attr-defined]
        assert session.run("echo fine", b"", timeout=20).stdout == b"fine\n"


def test_sixteen_at_once(lab: Lab, transport: Transport, connection: Connection) -> None:
    hosts = [lab.host(name, connection=connection) for name in lab.servers] * 6
    with ThreadPoolExecutor(16) as pool:
        replies = list(
            pool.map(
                lambda host: run_command(
                    transport, host, "cat", host.name.encode(), timeout=30
                ).stdout.decode(),
                hosts[:16],
            )
        )
    assert replies == [host.name for host in hosts[:16]]


def test_one_session_serves_many_threads(lab: Lab, transport: Transport) -> None:
    with transport.connect(lab.host("edge1"), timeout=10) as session, ThreadPoolExecutor(8) as pool:
        replies = list(
            pool.map(lambda n: session.run("cat", b"%d" % n * 10_000, timeout=20).stdout, range(24))
        )
    assert replies == [b"%d" % n * 10_000 for n in range(24)]


# -- host keys
# ---------------------------------------------------------------------------------------------------------------------


def other_key(tmp_path: Path) -> str:
    return make_key(tmp_path / "other_key")


def write_known_hosts_lines(kind: str, lab: Lab, name: str, other: str) -> str:
    """Return known_hosts lines that make server ``name`` appear as ``kind``; the other servers stay known."""
    server = lab[name]
    place = f"[{server.address}]:{server.port}"
    rest = "".join(s.known_hosts_line for s in lab.servers.values() if s is not server)
    return (
        rest
        + {
            "known": f"{place} {server.key}\n",
            "unknown": "",
            "changed": f"{place} {other}\n",
            "revoked": f"{place} {server.key}\n@revoked * {server.key}\n",
            "authority": f"@cert-authority * {other}\n{place} {server.key}\n",
            "only authority": f"@cert-authority * {other}\n",
        }[kind]
    )


@pytest.mark.parametrize("through", [None, "robot1"])
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("known", None),
        ("unknown", "not known"),
        ("changed", "changed"),
        ("revoked", "revoked"),
        ("authority", None),
        ("only authority", "not known"),
    ],
)
def test_host_keys(
    lab: Lab,
    transport: Transport,
    connection: Connection,
    tmp_path: Path,
    through: str | None,
    kind: str,
    words: str | None,
) -> None:
    """The key in question is the target's or, with a jump host, the jump host's."""
    lab.known_hosts.write_text(write_known_hosts_lines(kind, lab, through or "edge1", other_key(tmp_path)))
    before = lab.known_hosts.read_bytes()
    host = lab.host("edge1", connection=connection, proxy_jump=through)
    if words is None:
        assert run_command(transport, host).stdout == b"here\n"
    else:
        error, _ = measure_failure(transport, host)
        assert isinstance(error, HostKeyError)
        assert words in error.message
        assert error.hint
        assert (
            kind == "revoked"
            or ("ssh robot1" if through and connection is Connection.SSH else "edgectl trust edge1")
            in error.hint
        )
    assert lab.known_hosts.read_bytes() == before


@pytest.mark.parametrize("form", ["list", "krl", "other", "missing"])
def test_revoked_host_keys(
    lab: Lab, transport: Transport, connection: Connection, tmp_path: Path, form: str
) -> None:
    """A list or a KRL in RevokedHostKeys of ssh_config; an unreadable one revokes everything."""
    keys, krl = tmp_path / "revoked", tmp_path / "krl"
    keys.write_text((lab["edge1"].key if form != "other" else other_key(tmp_path)) + "\n")
    subprocess.run(["ssh-keygen", "-q", "-k", "-f", krl, keys], check=True, capture_output=True)
    named = {"krl": krl, "missing": tmp_path / "missing"}.get(form, keys)
    lab.write_files(f"RevokedHostKeys {named}")
    host = lab.host("edge1", connection=connection)
    if form == "other":
        assert run_command(transport, host).stdout == b"here\n"
    else:
        error, _ = measure_failure(transport, host)
        assert isinstance(error, HostKeyError)
        assert "revoked" in error.message


@pytest.mark.parametrize("through", [None, "robot1"])
def test_ssh_config_cannot_switch_verification_off(
    lab: Lab, transport: Transport, connection: Connection, through: str | None
) -> None:
    lab.write_files("StrictHostKeyChecking no", "NoHostAuthenticationForLocalhost yes")
    lab.known_hosts.write_text(write_known_hosts_lines("unknown", lab, through or "edge1", ""))
    error, _ = measure_failure(transport, lab.host("edge1", connection=connection, proxy_jump=through))
    assert isinstance(error, HostKeyError)


def test_the_target_behind_a_jump_host_is_verified_too(
    lab: Lab, transport: Transport, connection: Connection, tmp_path: Path
) -> None:
    lab.known_hosts.write_text(write_known_hosts_lines("changed", lab, "edge1", other_key(tmp_path)))
    error, _ = measure_failure(transport, lab.host("edge1", connection=connection, proxy_jump="robot1"))
    assert isinstance(error, HostKeyError)


def test_fingerprints_are_shown(lab: Lab, transport: Transport, connection: Connection) -> None:
    lab.known_hosts.write_text("")
    error, _ = measure_failure(transport, lab.host("edge1", connection=connection))
    # OpenSSH shows the fingerprint of a changed key only.
    assert connection is Connection.OPENSSH or "SHA256:" in error.message


@pytest.mark.parametrize("hashed", [False, True])
def test_accept_new_records_unknown_keys_only(
    lab: Lab, connection: Connection, tmp_path: Path, hashed: bool
) -> None:
    server, other = lab["edge1"], other_key(tmp_path)
    lab.write_files(*(["HashKnownHosts yes"] if hashed else []))
    lab.known_hosts.unlink()
    os.umask(0o000)
    try:
        assert (
            run_command(FleetTransport(accept_new=True), lab.host("edge1", connection=connection)).stdout
            == b"here\n"
        )
    finally:
        os.umask(0o022)
    line = lab.known_hosts.read_text()
    assert line.startswith("|1|") if hashed else line == server.known_hosts_line
    # The file that ssh itself creates is 0644.
    assert lab.known_hosts.stat().st_mode & (0o777 if connection is Connection.SSH else 0o022) == (
        0o600 if connection is Connection.SSH else 0
    )
    assert run_command(FleetTransport(), lab.host("edge1", connection=connection)).stdout == b"here\n"
    lab.known_hosts.write_text(f"[{server.address}]:{server.port} {other}\n")
    assert isinstance(
        measure_failure(FleetTransport(accept_new=True), lab.host("edge1", connection=connection))[0],
        HostKeyError,
    )
    assert other in lab.known_hosts.read_text()
    assert server.key not in lab.known_hosts.read_text()


def test_a_reinstalled_host_is_refused_before_login(
    tmp_path: Path, transport: Transport, connection: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_lab(tmp_path / "lab", ["edge1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        lab["edge1"].change_key()
        error, _ = measure_failure(transport, lab.host("edge1", connection=connection))
        assert isinstance(error, HostKeyError)
        assert "Accepted" not in lab["edge1"].log
        assert "Failed publickey" not in lab["edge1"].log


# -- connecting
# -----------------------------------------------------------------------------------------------------------------------


def test_login_refused_once(lab: Lab, transport: Transport, connection: Connection, tmp_path: Path) -> None:
    make_key(tmp_path / "stranger")
    lab.write_files(key=tmp_path / "stranger")
    lab["edge1"].restart()  # with an empty log: sshd may still be logging the sessions before
    error, seconds = measure_failure(transport, lab.host("edge1", connection=connection))
    assert isinstance(error, AuthError)
    assert seconds < BUSY_S
    deadline = time.monotonic() + BUSY_S
    while not (tries := lab["edge1"].log.count("Connection closed")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert tries == 1


def test_no_key_at_all(lab: Lab, transport: Transport, connection: Connection, tmp_path: Path) -> None:
    lab.write_files(key=tmp_path / "missing")
    error, _ = measure_failure(transport, lab.host("edge1", connection=connection))
    assert isinstance(error, AuthError)


def test_closed_port(lab: Lab, transport: Transport, connection: Connection) -> None:
    error, seconds = measure_failure(transport, lab.host("edge1", connection=connection, port=1))
    assert isinstance(error, ConnectError)
    assert "refused" in error.message
    assert seconds < BUSY_S


def test_closed_port_behind_a_jump_host(lab: Lab, transport: Transport, connection: Connection) -> None:
    error, seconds = measure_failure(
        transport, lab.host("edge1", connection=connection, port=1, proxy_jump="robot1"), timeout=20.0
    )
    assert isinstance(error, ConnectError)
    assert seconds < BUSY_S


def test_unknown_name(lab: Lab, transport: Transport, connection: Connection) -> None:
    error, _ = measure_failure(
        transport,
        Host(name="x", role=lab.host("edge1").role, host="no-such-host.invalid", connection=connection),
    )
    assert isinstance(error, ConnectError)


def test_a_name_is_no_option(lab: Lab, transport: Transport, connection: Connection, tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    error, _ = measure_failure(
        transport, lab.host("edge1", host=f"-oProxyCommand=touch {canary}", connection=connection)
    )
    assert isinstance(error, ConnectError)
    assert not canary.exists()


def test_a_mute_server(transport: Transport, connection: Connection, lab: Lab) -> None:
    with run_mute_server() as port:
        error, seconds = measure_failure(
            transport,
            Host(name="m", role=lab.host("edge1").role, host="127.0.0.1", port=port, connection=connection),
            timeout=2,
        )
    assert isinstance(error, DeadlineError)
    assert seconds < BUSY_S


@pytest.mark.parametrize("after", [0, 500, 1200, 1700])
def test_silence_during_login(lab: Lab, transport: Transport, connection: Connection, after: int) -> None:
    server = lab["edge1"]
    with run_relay((server.address, server.port), RelayFault.SILENCE, after) as port:
        lab.known_hosts.write_text(f"[127.0.0.1]:{port} {server.key}\n")
        error, seconds = measure_failure(
            transport, lab.host("edge1", host="127.0.0.1", port=port, connection=connection), timeout=2
        )
    assert isinstance(error, DeadlineError)
    assert seconds < BUSY_S


def test_silence_in_the_middle_of_output(lab: Lab, transport: Transport, connection: Connection) -> None:
    server = lab["edge1"]
    with run_relay((server.address, server.port), RelayFault.SILENCE, 200_000) as port:
        lab.known_hosts.write_text(f"[127.0.0.1]:{port} {server.key}\n")
        host = lab.host("edge1", host="127.0.0.1", port=port, connection=connection)
        with transport.connect(host, timeout=20) as session:
            start = time.monotonic()
            with pytest.raises(DeadlineError):
                session.run("head -c 800000 /dev/zero", b"", timeout=2)
            assert time.monotonic() - start < BUSY_S


def test_a_jump_host_that_falls_silent(lab: Lab, transport: Transport, connection: Connection) -> None:
    jump = lab["robot1"]
    with run_relay((jump.address, jump.port), RelayFault.SILENCE, 300_000) as port:
        lab.known_hosts.write_text(lab.known_hosts.read_text() + f"[127.0.0.1]:{port} {jump.key}\n")
        session = transport.connect(
            lab.host("edge1", proxy_jump=f"127.0.0.1:{port}", connection=connection), timeout=20
        )
        start = time.monotonic()
        with pytest.raises(DeadlineError):
            session.run("head -c 900000 /dev/zero", b"", timeout=2)
        session.close()
        assert time.monotonic() - start < BUSY_S


@pytest.mark.parametrize("after", [10, 1500, 30_000])
def test_a_line_that_is_cut(lab: Lab, transport: Transport, connection: Connection, after: int) -> None:
    server = lab["edge1"]
    with run_relay((server.address, server.port), RelayFault.CUT, after) as port:
        lab.known_hosts.write_text(f"[127.0.0.1]:{port} {server.key}\n")
        host = lab.host("edge1", host="127.0.0.1", port=port, connection=connection)
        error, seconds = measure_failure(transport, host, "head -c 800000 /dev/zero; sleep 60", timeout=30)
    assert isinstance(error, ConnectError)
    assert seconds < BUSY_S


def test_a_host_that_dies_during_a_stream(
    tmp_path: Path, transport: Transport, connection: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_lab(tmp_path / "lab", ["edge1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        with transport.connect(lab.host("edge1", connection=connection), timeout=20) as session:
            pieces = session.stream("echo first; sleep 60", b"", idle_timeout=30)
            assert next(pieces) == b"first\n"
            lab["edge1"].stop()
            with pytest.raises(ConnectError):
                list(pieces)


# -- routes
# --------------------------------------------------------------------------------------------------------------------------


def test_two_jumps(lab: Lab, transport: Transport, connection: Connection) -> None:
    assert (
        run_command(transport, lab.host("edge1", connection=connection, proxy_jump="edge2,robot1")).stdout
        == b"here\n"
    )


def test_proxy_jump_of_ssh_config(lab: Lab, transport: Transport, connection: Connection) -> None:
    server = lab["edge2"]
    lab.write_files(f"Host far\n  HostName {server.address}\n  Port {server.port}\n  ProxyJump robot1")
    assert run_command(
        transport, lab.host("edge2", host="far", connection=connection), "echo $HOME"
    ).stdout.decode().strip() == str(server.home)


def test_jumpers_share_a_jump_host(lab: Lab, transport: Transport) -> None:
    before = lab["robot1"].log.count("Accepted publickey")
    with ThreadPoolExecutor(8) as pool:
        hosts = [lab.host(name, proxy_jump="robot1") for name in ("edge1", "edge2")] * 4
        sessions = list(pool.map(lambda host: transport.connect(host, timeout=20), hosts))
        assert {session.run("echo here", b"", timeout=10).stdout for session in sessions} == {b"here\n"}
        assert lab["robot1"].log.count("Accepted publickey") - before == 1
    for session in sessions:
        session.close()
    deadline = time.monotonic() + BUSY_S
    while [thread for thread in threading.enumerate() if thread.daemon]:
        assert time.monotonic() < deadline, "sessions of jump hosts are closed with their last user"
        time.sleep(0.05)


def test_proxy_command(lab: Lab, transport: Transport, connection: Connection) -> None:
    robot, edge = lab["robot1"], lab["edge1"]
    command = f"ssh -F {lab.ssh_config} -W %h:%p robot1"
    lab.write_files(f"Host far\n  HostName {edge.address}\n  Port {edge.port}\n  ProxyCommand {command}")
    before = robot.log.count("Accepted publickey")
    assert run_command(transport, lab.host("edge1", host="far", connection=connection)).stdout == b"here\n"
    assert robot.log.count("Accepted publickey") == before + 1


@pytest.mark.parametrize("command", ["false", "sleep 0.2; exit 3", "echo this is not ssh"])
def test_a_dead_proxy_command_costs_nothing(
    lab: Lab, transport: Transport, connection: Connection, command: str
) -> None:
    lab.write_files(f"Host far\n  HostName 127.0.0.1\n  ProxyCommand {command}")
    spent = time.process_time()
    error, seconds = measure_failure(
        transport, lab.host("edge1", host="far", connection=connection), timeout=30.0
    )
    assert isinstance(error, ConnectError)
    assert seconds < BUSY_S
    assert time.process_time() - spent < 10.0, "paramiko alone burns a core until its deadline"
    assert not [pid for pid in list_children() if "Z" in read_process_state(pid)]


def test_whoever_closes_a_proxy_command_finds_it_reaped() -> None:
    for _ in range(30):
        before = {*list_children()}
        line = start_proxy_command("sleep 60")
        (pid,) = {*list_children()} - before
        both = threading.Barrier(2)

        def close(line: ProxySocket = line, pid: str = pid, both: threading.Barrier = both) -> bool:
            both.wait()
            line.close()
            return Path(f"/proc/{pid}").exists()

        with ThreadPoolExecutor(2) as pool:
            assert not any(future.result() for future in [pool.submit(close), pool.submit(close)])


def list_children() -> list[str]:
    return Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()


def read_process_state(pid: str) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
