# SPDX-License-Identifier: Apache-2.0
"""The client of etcd against a real one, and against servers that are none."""

import json
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import CoordinationError
from edgectl.model.inventory import Coordination
from edgectl.transport.etcd_client import EtcdClient, encode_text
from edgectl.transport.etcd_lease import EtcdLease, Holder, read_fleet_keys, take_fleet
from edgectl.transport.fleet_lease import FleetLease, LeaseLostError
from tests.etcd import EtcdCluster, reserve_port, running_etcd
from tests.pace import patience

ANA = Holder(manager="ana", session="a1", who="ana@lab", verb="apply")
BEN = Holder(manager="ben", session="b1", who="ben@lab", verb="watch", every_s=10.0)


class Clock:
    """Seconds of a manager."""

    def __init__(self) -> None:
        self.lead = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.lead


def take(
    etcd: EtcdCluster, fleet: str, holder: Holder, *, ttl_s: int = 15, clock: Clock | None = None
) -> EtcdLease:
    taken = take_fleet(EtcdClient(etcd.place), fleet, holder, clock=clock or Clock(), ttl_s=ttl_s)
    assert isinstance(taken, EtcdLease), taken
    return taken


def test_one_holder_at_a_time_and_each_with_a_later_revision(etcd: EtcdCluster, tmp_path: Path) -> None:
    fleet = tmp_path.name
    with take(etcd, fleet, ANA).keep_alive():
        told = take_fleet(EtcdClient(etcd.place), fleet, BEN, clock=Clock())
        assert isinstance(told, Holder)
        assert (told.who, told.verb) == ("ana@lab", "apply")
        assert 10 <= told.left_s <= 15
        first = read_fleet_keys(EtcdClient(etcd.place), fleet).holder_revision
        # A new run of the same machine replaces it, and the old one can save nothing any more.
        old, new = take(etcd, fleet, ANA), take(etcd, fleet, replace(ANA, session="a2"))
    assert first < old.revision < new.revision
    with pytest.raises(CoordinationError, match="has run out: nothing was saved there"):
        old.save_state(b"of the old one")
    assert old.is_over()
    with new.keep_alive():
        revision = new.save_state(b"of the new one")
    keys = read_fleet_keys(EtcdClient(etcd.place), fleet)
    assert (keys.holder, keys.state, keys.state_revision) == (None, b"of the new one", revision)
    later = take(etcd, fleet, BEN)
    assert later.revision > revision
    assert (later.keys.state, later.keys.id) == (b"of the new one", new.keys.id)


def test_of_many_that_take_it_at_once_one_has_it(etcd: EtcdCluster, tmp_path: Path) -> None:
    taken: list[EtcdLease | Holder] = []
    holders = [replace(ANA, manager=f"m{number}", session=f"s{number}") for number in range(8)]
    threads = [
        threading.Thread(
            target=lambda each=each: taken.append(
                take_fleet(EtcdClient(etcd.place), tmp_path.name, each, clock=Clock())
            )
        )
        for each in holders
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(isinstance(each, EtcdLease) for each in taken) == 1
    assert len(taken) == 8


def test_it_lasts_while_it_is_kept_alive_and_one_lease_longer(etcd: EtcdCluster, tmp_path: Path) -> None:
    lease = take(etcd, tmp_path.name, ANA, ttl_s=1)
    with lease.keep_alive():
        until = time.monotonic() + 1.6
        while time.monotonic() < until:
            assert not lease.is_over()
            assert isinstance(take_fleet(EtcdClient(etcd.place), tmp_path.name, BEN, clock=Clock()), Holder)
            time.sleep(0.2)
    take(etcd, tmp_path.name, ANA, ttl_s=1)  # never kept alive: its process was killed
    began = time.monotonic()
    while isinstance(take_fleet(EtcdClient(etcd.place), tmp_path.name, BEN, clock=Clock()), Holder):
        assert time.monotonic() < began + patience(10.0)
        time.sleep(0.1)
    assert time.monotonic() - began > 0.5


def test_another_machine_has_the_fleet_of_a_killed_manager_within_ten_seconds(
    etcd: EtcdCluster, tmp_path: Path
) -> None:
    """It asks as often as a command that waits."""
    began = time.monotonic()
    take_fleet(EtcdClient(etcd.place), tmp_path.name, ANA, clock=Clock())  # never kept alive
    asked = 0
    while isinstance(take_fleet(EtcdClient(etcd.place), tmp_path.name, BEN, clock=Clock()), Holder):
        assert time.monotonic() - began < patience(10.0)
        time.sleep(0.3)
        asked += 1
    assert asked > 5, "it was held by the first one"


def test_a_lease_that_ran_out_by_our_clock_stays_so(etcd: EtcdCluster, tmp_path: Path) -> None:
    clock = Clock()
    term = take(etcd, tmp_path.name, ANA, clock=clock)
    lease = FleetLease(holder="h", session="a1", who="ana", verb="apply", clock=clock, term=term)
    lease.build_claim("edge1")
    lease.take_reply("edge1", {"state": "granted", "epoch": 1})
    assert lease.sign("edge1")["epoch"] == 1
    clock.lead = 15.0
    with pytest.raises(LeaseLostError, match="in etcd has run out: nothing was sent"):
        lease.sign("edge1")
    clock.lead = 0.0
    assert term.renew()  # etcd has it still, but another manager may have had it in between
    assert term.is_over()


def test_a_failed_endpoint_is_passed_over_and_a_silent_one_has_its_share_of_time(etcd: EtcdCluster) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent, reserve_port() as closed:
        ports = [closed.getsockname()[1], silent.getsockname()[1], etcd.servers[0].port]
        client = EtcdClient(Coordination(endpoints=tuple(("127.0.0.1", port) for port in ports)))
        timeout = patience(1.0)
        began = time.monotonic()
        assert "header" in client.call("kv/range", {"key": encode_text("a")}, timeout=timeout)
        assert 0.3 * timeout < time.monotonic() - began < timeout
        began = time.monotonic()
        client.call("kv/range", {"key": encode_text("a")}, timeout=timeout)
        assert time.monotonic() - began < 0.4 * timeout  # the one that answered comes first now


@contextmanager
def serving(answer: Callable[[socket.socket], None]) -> Iterator[EtcdClient]:
    """A server that sends what it likes, for one connection after the other."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    line, _ = server.accept()
                    with line:
                        line.recv(65536)
                        answer(line)
                except OSError:
                    return

        threading.Thread(target=serve, daemon=True).start()
        yield EtcdClient(Coordination(endpoints=(("127.0.0.1", server.getsockname()[1]),)))
        server.shutdown(socket.SHUT_RDWR)


def reply(body: str | bytes, status: str = "200 OK") -> Callable[[socket.socket], None]:
    data = body.encode() if isinstance(body, str) else body
    return lambda line: line.sendall(f"HTTP/1.1 {status}\r\n\r\n".encode() + data)


def drip(line: socket.socket) -> None:
    for byte in b"HTTP/1.1 200 OK\r\n" + b"X-A: b\r\n" * 1000:
        line.sendall(bytes([byte]))
        time.sleep(0.02)


def flood(line: socket.socket) -> None:
    line.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    for _ in range(200):
        line.sendall(bytes(1 << 16))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (drip, "no answer within 0.5 s"),
        (lambda line: time.sleep(0.7), "no answer within 0.5 s"),
        (flood, "not the answer of an etcd"),
        (reply("<html>"), "not the answer of an etcd"),
        (reply("[" * 100_000), "not the answer of an etcd"),
        (reply("[]"), "not the answer of an etcd"),
        (reply('{"error": "no \\u001b[31m leader", "code": 14}', "503 No"), r"no \\x1b\[31m leader"),
        (lambda line: None, "remote end closed connection without response"),
        (lambda line: line.sendall(b"SSH-2.0-x\r\n"), "not the answer of an etcd"),
    ],
)
def test_a_hostile_server_costs_its_deadline_and_one_line(
    answer: Callable[[socket.socket], None], message: str
) -> None:
    began = time.monotonic()
    with serving(answer) as client, pytest.raises(CoordinationError, match=message) as told:
        client.call("kv/range", {"key": encode_text("a")}, timeout=0.5)
    assert time.monotonic() - began < patience(2.0)
    assert told.value.message.isprintable()


@pytest.mark.parametrize(("changes", "asked"), [(1, 2), (2, 2)])
def test_a_member_that_chose_another_leader_is_asked_once_more(changes: int, asked: int) -> None:
    changed = json.dumps({"error": "etcdserver: leader changed", "code": 14})
    answers = [reply(changed, "503 Service Unavailable")] * changes + [reply('{"kvs": []}')]
    calls: list[socket.socket] = []

    def answer(line: socket.socket) -> None:
        calls.append(line)
        answers[len(calls) - 1](line)

    with serving(answer) as client:
        if changes < asked:
            assert client.call("kv/range", {"key": encode_text("a")}) == {"kvs": []}
        else:
            with pytest.raises(CoordinationError, match="leader changed"):
                client.call("kv/range", {"key": encode_text("a")})
    assert len(calls) == asked


@pytest.mark.parametrize(
    "body",
    [
        {"kvs": 7},
        {"kvs": [{"key": "%"}]},
        {"kvs": [{"key": encode_text("edgectl/lab/id"), "value": encode_text("../../x")}]},
        {"kvs": [{"key": encode_text("edgectl/lab/id"), "mod_revision": -1}]},
        {"kvs": [{"key": encode_text("edgectl/lab/id"), "mod_revision": str(2**63)}]},
        {"kvs": [{"key": encode_text("edgectl/lab/id"), "mod_revision": [1]}]},
    ],
)
def test_a_damaged_answer_is_refused(body: dict[str, object]) -> None:
    with serving(reply(json.dumps(body))) as client, pytest.raises(CoordinationError, match="no valid"):
        read_fleet_keys(client, "lab")


def test_the_words_of_a_holder_are_cut_and_escaped() -> None:
    value = {"who": "\x1b[31m" + "x" * 500, "verb": [1], "every_s": 1e999, "manager": "m", "session": None}
    pair = {"key": encode_text("edgectl/lab/holder"), "value": encode_text(json.dumps(value))}
    with serving(reply(json.dumps({"kvs": [pair]}))) as client:
        holder = read_fleet_keys(client, "lab").holder
    assert holder is not None
    assert holder.who.startswith("\\x1b[31mxxx")
    assert (len(holder.who) < 100, holder.verb, holder.every_s, holder.session) == (True, "[1]", 0.0, "")


def make_certificate(folder: Path) -> tuple[Path, Path]:
    """Certificate and key of 127.0.0.1, signed by itself."""
    cert, key = folder / "cert.pem", folder / "key.pem"
    words = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=etcd"
    more = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(cert)]
    subprocess.run(["openssl", *words.split(), *more], check=True, capture_output=True)
    return cert, key


def test_with_tls_the_server_is_verified_and_may_verify_the_client(tmp_path: Path) -> None:
    cert, key = make_certificate(tmp_path)
    files = (f"--cert-file={cert}", f"--key-file={key}", f"--trusted-ca-file={cert}", "--client-cert-auth")
    with running_etcd(tmp_path, 1, *files) as cluster:
        place = replace(cluster.place, tls=True, ca=str(cert), cert=str(cert), key=str(key))
        client, deadline = EtcdClient(place), time.monotonic() + patience(20.0)
        while True:
            try:
                client.call("kv/range", {"key": encode_text("a")})
            except CoordinationError:
                assert time.monotonic() < deadline
                time.sleep(0.02)
            else:
                break
        for wrong, message in (
            (replace(place, ca=""), "TLS: .*self.signed certificate"),
            (
                replace(place, cert="", key=""),
                "certificate required|bad certificate|reset|closed|broken pipe",
            ),
            (replace(place, ca=str(tmp_path / "none")), "cannot read a certificate of coordination"),
            (replace(place, tls=False, ca="", cert="", key=""), "does not answer"),
        ):
            with pytest.raises(CoordinationError, match=message):
                EtcdClient(wrong).call("kv/range", {"key": encode_text("a")})


def test_a_user_logs_in_with_a_password_of_a_program(tmp_path: Path) -> None:
    with running_etcd(tmp_path) as cluster:
        for operation, body in (
            ("auth/user/add", {"name": "root", "password": "r"}),
            ("auth/user/add", {"name": "edgectl", "password": "secret"}),
            ("auth/role/add", {"name": "root"}),
            ("auth/role/add", {"name": "edgectl"}),
            (
                "auth/role/grant",
                {
                    "name": "edgectl",
                    "perm": {
                        "permType": "READWRITE",
                        "key": encode_text("edgectl/"),
                        "range_end": encode_text("edgectl0"),
                    },
                },
            ),
            ("auth/user/grant", {"user": "root", "role": "root"}),
            ("auth/user/grant", {"user": "edgectl", "role": "edgectl"}),
            ("auth/enable", {}),
        ):
            cluster.ask(operation, dict(body))
        with pytest.raises(CoordinationError, match="etcd refuses kv/range"):
            read_fleet_keys(EtcdClient(cluster.place), "lab")
        place = replace(cluster.place, user="edgectl", password_command=("echo", "secret"))
        lease = take_fleet(EtcdClient(place), "lab", ANA, clock=Clock())
        assert isinstance(lease, EtcdLease)
        with lease.keep_alive():
            assert lease.renew()
            lease.save_state(b"state")
        for wrong, message in (
            (("echo", "wrong"), "authentication failed"),
            (("false",), "password_command printed no password"),
        ):
            with pytest.raises(CoordinationError, match=message) as told:
                read_fleet_keys(EtcdClient(replace(place, password_command=wrong)), "lab")
            assert "secret" not in told.value.message
        found = EtcdClient(place).read_versions()
        assert all(isinstance(each, str) for each in found.values()), found
