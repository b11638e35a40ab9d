"""A small fleet to break: real hosts, test tasks, and the product driven through its command line only.

``Fleet.want`` says what should run where; the oracle compares that with what the tasks wrote about themselves.
"""

import json
import os
import pty
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults import armed, oracle, scan
from tests.faults.computer import NamespaceHost, namespace_hosts
from tests.faults.hosts import Host, loopback_hosts
from tests.faults.oracle import Verdict
from tests.faults.outcome import WORST_S, ExpectationError, Outcome
from tests.faults.relay import Relay
from tests.pace import patience

EDGECTL = Path(sys.executable).with_name("edgectl")
APPLY = ("apply", "--yes")


def as_yaml(document: object) -> str:
    """JSON is YAML, save for its surrogate pairs."""
    return json.dumps(document, indent=1, ensure_ascii=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class How:
    """Which edgectl is judged: ``code`` is a directory that holds another package, ``connection`` the way that it takes to the hosts;
    ``sample``: of kill points, a few drawn at random instead of all."""

    code: Path | None = None
    connection: str = "ssh"
    sample: bool = False


@dataclass(kw_only=True)
class Fleet:
    """Hosts, the files that describe them to edgectl, and what should run."""

    directory: Path
    hosts: dict[str, Host]
    key_file: Path
    prefix: list[str]
    netns: Path | None
    draw: random.Random
    mark: str = field(default_factory=lambda: f"faults-{os.urandom(6).hex()}")
    tasks: dict[str, dict[str, object]] = field(default_factory=dict)
    expected: dict[str, str | None] = field(default_factory=dict)
    inventory: dict[str, dict[str, object]] = field(default_factory=dict)
    relays: dict[str, Relay] = field(default_factory=dict)
    canaries: list[scan.Canary] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    overlap_allowed: set[str] = field(default_factory=set)
    code: Path | None = None
    connection: str = "ssh"
    sample: bool = False
    deadly: int | None = None
    injected: int = 0
    stack: ExitStack = field(default_factory=ExitStack)
    begun_ns: int = field(default_factory=oracle.now_ns)
    outcomes: list[Outcome] = field(default_factory=list)

    def __post_init__(self) -> None:
        for place in ("home", "state", "tmp"):
            (self.directory / place).mkdir(parents=True)
        for name in self.hosts:
            self.inventory[name] = {
                "host": name,
                "connection": self.connection,
                "capacity": {"cpu": 4, "memory": "8Gi"},
            }
        self.write()

    # What should run

    def want(self, name: str, *options: str, on: str | None = None, **fields: object) -> None:
        """Task ``name`` shall run, pinned to host ``on``; ``options`` are the beacon's."""
        words = " ".join(options)
        command = f'exec python3 "$HOME/oracle/beacon.py" --dir "$HOME/oracle/records" --task {name} --mark {self.mark} {words}'
        entry: dict[str, object] = {
            "command": command,
            "demand": {"cpu": 0.1, "memory": "10Mi"},
            "stop": {"grace": "3s"},
            **fields,
        }
        if on:
            entry["hosts"] = {"pin": on}
        self.tasks[name] = entry
        self.expected[name] = on
        self.write()

    def pin(self, name: str, on: str | None) -> None:
        """Task ``name`` shall run on host ``on`` (None: wherever edgectl likes)."""
        self.tasks[name].pop("hosts", None)
        if on:
            self.tasks[name]["hosts"] = {"pin": on}
        self.expected[name] = on
        self.write()

    def unwant(self, name: str) -> None:
        """Task ``name`` shall not run any more."""
        del self.tasks[name], self.expected[name]
        self.write()

    # The files

    @property
    def state(self) -> Path:
        return self.directory / "state"

    def write(self) -> None:
        """Write what edgectl and ssh read. JSON is YAML."""
        (self.directory / "inventory.yaml").write_text(as_yaml({"version": 1, "edges": self.inventory}))
        (self.directory / "tasks.yaml").write_text(as_yaml({"version": 1, "tasks": self.tasks}))
        self._write_ssh()

    def _write_ssh(self) -> None:
        config, known = [], []
        for name, host in self.hosts.items():
            address, port, user, key = host.login
            key = self.keys.setdefault(name, key)
            if relay := self.relays.get(name):
                address, port = relay.address, relay.port
            config.append(f"Host {name}\n  HostName {address}\n  Port {port}\n  User {user}\n")
            known.append(f"{address if port == 22 else f'[{address}]:{port}'} {key}\n")
        common = [
            f"IdentityFile {self.key_file}",
            "IdentitiesOnly yes",
            "IdentityAgent none",
            "GlobalKnownHostsFile none",
        ]
        common.append(f"UserKnownHostsFile {self.directory / 'known_hosts'}")
        (self.directory / "known_hosts").write_text("".join(known))
        (self.directory / "ssh_config").write_text(
            "".join(config) + "Host *\n" + "".join(f"  {line}\n" for line in common)
        )

    def trust_again(self) -> None:
        """The operator accepts the present host keys."""
        self.keys = {}
        self.write()

    def relay(self, name: str) -> Relay:
        """From now on the way to host ``name`` leads through a relay."""
        if name not in self.relays:
            address, port, *_ = self.hosts[name].login
            relay = Relay((address, port), netns=self.netns)
            relay.start()
            self.stack.callback(relay.stop)
            self.relays[name] = relay
            self.write()
        return self.relays[name]

    def computer(self, name: str) -> NamespaceHost:
        """Host ``name``, known to be a computer of its own."""
        host = self.hosts[name]
        assert isinstance(host, NamespaceHost)
        return host

    def canary(self, host: str, *words: str, pid: int = 0) -> None:
        """A foreign process on the host."""
        self.canaries.append(self.hosts[host].canary(f"canary{len(self.canaries)}", *words, pid=pid))

    # The product

    def environment(self, **more: str) -> dict[str, str]:
        base = {
            "PATH": "/usr/local/bin:/usr/bin:/bin",
            "HOME": str(self.directory / "home"),
            "LC_ALL": "C.UTF-8",
            "TMPDIR": str(self.directory / "tmp"),
        }
        ours = {
            "EDGECTL_STATE_DIR": str(self.state),
            "EDGECTL_SSH_CONFIG": str(self.directory / "ssh_config"),
            "NO_COLOR": "1",
        }
        return base | ours | ({"PYTHONPATH": str(self.code)} if self.code else {}) | more

    def line(self, *words: str) -> list[str]:
        """The command line of edgectl with this fleet's files."""
        files = ["-i", str(self.directory / "inventory.yaml"), "-t", str(self.directory / "tasks.yaml")]
        program = [str(EDGECTL)] if self.deadly is None else armed.line(self.notes, self.deadly)
        return [*self.prefix, *program, *words, *files]

    @property
    def notes(self) -> Path:
        """The named points that an edgectl with ``deadly`` has reached; see `armed`."""
        return self.directory / "points"

    def begin(self, *words: str, **env: str) -> "subprocess.Popen[str]":
        """Start edgectl and do not wait."""
        return subprocess.Popen(
            self.line(*words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment(**env),
            start_new_session=True,
        )

    def end(
        self, process: "subprocess.Popen[str]", words: tuple[str, ...] = APPLY, *, begun: float | None = None
    ) -> Outcome:
        """Wait for edgectl (at most two minutes)."""
        begun = begun or time.monotonic()
        try:
            out, err = process.communicate(timeout=patience(WORST_S))
        except subprocess.TimeoutExpired as hung:
            os.killpg(process.pid, signal.SIGKILL)
            _, err = process.communicate()
            raise ExpectationError(
                f"edgectl {' '.join(words)} still runs after {WORST_S:.0f} s: {err[-300:]}"
            ) from hung
        outcome = Outcome(
            words=words, code=process.returncode, out=out, err=err, seconds=time.monotonic() - begun
        )
        self.outcomes.append(outcome)
        if "Traceback" in outcome.err + outcome.out:
            raise ExpectationError(f"a traceback: {outcome}")
        return outcome

    def edgectl(self, *words: str, **env: str) -> Outcome:
        """Run edgectl to its end."""
        begun = time.monotonic()
        return self.end(self.begin(*words, **env), words, begun=begun)

    def on_terminal(self, *words: str) -> str:
        """What edgectl writes to a terminal."""
        ours, theirs = pty.openpty()
        done = subprocess.Popen(
            self.line(*words),
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=self.environment(TERM="xterm"),
            start_new_session=True,
        )
        os.close(theirs)
        data = b""
        with os.fdopen(ours, "rb", buffering=0) as terminal, suppress(OSError):
            while part := terminal.read(65536):
                data += part
        done.wait(patience(WORST_S))
        return data.decode(errors="replace")

    def apply(self, **env: str) -> Outcome:
        """Run apply."""
        return self.edgectl(*APPLY, **env)

    # The verdict

    @property
    def records(self) -> dict[str, Path]:
        return {name: host.records for name, host in self.hosts.items()}

    def judge(
        self,
        expected: Mapping[str, str | None] | None = None,
        *,
        seconds: float = 0.7,
        patience: float = 12.0,
    ) -> Verdict:
        """The oracle's word on what runs now and what ever overlapped; ``expected`` instead of what is wanted."""
        wanted = self.expected if expected is None else expected
        found = oracle.judge(
            self.records,
            wanted,
            since_ns=self.begun_ns,
            overlap_allowed=self.overlap_allowed,
            seconds=seconds,
            patience=patience,
        )
        harm = tuple(word for canary in self.canaries for word in canary.harm())
        return Verdict(lost=found.lost, doubled=found.doubled, foreign=harm)

    def check(self, expected: Mapping[str, str | None] | None = None) -> None:
        """Insist on a clean verdict."""
        if not (verdict := self.judge(expected)).clean:
            raise OracleError(verdict)

    def settle(self) -> None:
        """One apply, and everything runs as wanted."""
        self.apply().must(0)
        self.check()

    def clock(self, seconds: float) -> None:
        """Let the world go on for a while."""
        time.sleep(seconds)

    def stopped(self, task: str) -> bool:
        """Whether the last launch of the task has said that it ends."""
        found = oracle.by_task(oracle.lives(self.records)).get(task)
        return bool(found) and found[-1].stopped

    def probed(self, host: str) -> dict[str, object]:
        """What edgectl measures on the host."""
        hosts = self.edgectl("probe", "-o", "json").must(0, 4).data["hosts"]
        assert isinstance(hosts, dict)
        return dict(hosts[host])

    def launches(self, task: str) -> int:
        """How often the task was started so far."""
        return len(oracle.by_task(oracle.lives(self.records)).get(task, []))

    def leftovers(self) -> Verdict:
        """What there is after everything was stopped: processes, held locks, files that others may read."""
        left = [
            f"{name}: process {each.pid} {each.command[:90]}"
            for name, host in self.hosts.items()
            for each in host.processes()
        ]
        left += [f"process {each.pid} {each.command[:90]}" for each in scan.marked(self.mark)]
        places = [
            path for host in self.hosts.values() for path in (host.home / ".local", host.home / "state")
        ]
        left += [
            f"temporary file {path}"
            for path in scan.files_under(self.state, *places)
            if path.suffix == ".tmp"
        ]
        left += scan.locks_under(self.state, *places)
        left += [
            f"open to others: {path}"
            for path in scan.exposed(self.state / "fleets", *(place / "edgectl" for place in places))
        ]
        return Verdict(left=tuple(sorted(set(left))))


class OracleError(AssertionError):
    """The oracle found something."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(str(verdict))
        self.verdict = verdict


def heal(fleet: Fleet) -> None:
    """Power, cables, relays, disks, logins: all as new. Host keys are what they are."""
    for relay in fleet.relays.values():
        relay.heal()
    for host in fleet.hosts.values():
        if isinstance(host, NamespaceHost) and host.pid:
            host.cable_in()
            host.free_disk()
            host.home_read_only(yes=False)
        host.boot()
        host.admit(everybody=True)


@contextmanager
def fleet_of(
    kind: str, directory: Path, names: list[str], seed: int, how: "How | None" = None
) -> Iterator[Fleet]:
    """A fleet of hosts of that kind, ended and cleaned at the end."""
    how = how or How()
    with ExitStack() as stack:
        prefix: list[str] = []
        netns = None
        if kind == "namespace":
            site, hosts = stack.enter_context(namespace_hosts(directory / "hosts", names))
            prefix, netns = site.prefix, site.netns
        else:
            hosts = stack.enter_context(loopback_hosts(directory / "hosts", names))
        fleet = Fleet(
            directory=directory / "manager",
            hosts=hosts,
            key_file=directory / "hosts" / "user_key",
            prefix=prefix,
            netns=netns,
            draw=random.Random(seed),
            stack=stack,
            code=how.code,
            connection=how.connection,
            sample=how.sample,
        )
        stack.callback(lambda: scan.end(scan.marked(fleet.mark)))
        yield fleet
