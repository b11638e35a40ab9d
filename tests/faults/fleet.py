# SPDX-License-Identifier: Apache-2.0
"""Fleet for fault injection: real hosts, test tasks, and edgectl driven through its command line only.

``FaultFleet.add_task`` says what should run where; the oracle compares that with the records of the tasks.
"""

import json
import os
import pty
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests import forkserver
from tests.compiled_agent import give_key
from tests.containers.docker_engine import IMAGE, SYSTEM
from tests.faults import failpoint_runner, oracle, scan
from tests.faults.command_result import WORST_S, CommandResult, ExpectationError
from tests.faults.computer_engine import ComputerEngine
from tests.faults.hosts import Host, start_loopback_hosts
from tests.faults.messages import Subscriber, subscribe
from tests.faults.namespace_host import NamespaceHost, start_namespace_hosts
from tests.faults.oracle import OracleVerdict
from tests.faults.relay import Relay
from tests.faults.swarm_fleet import await_nodes, form_swarm, list_left_services, trust_manager
from tests.pace import patience

EDGECTL = Path(sys.executable).with_name("edgectl")
APPLY = ("apply", "--yes")
FLEET = "faults"
REMOVAL_S = 10.0


def find_supervisor(main: scan.Process, table: Mapping[int, scan.Process]) -> scan.Process | None:
    """Find the supervisor of a task by one of its processes: its parent; where it is in a container, the parent of the
    runner, whose child is the engine's program that follows this very container.
    """
    with suppress(OSError):
        inside = re.search(r"[0-9a-f]{64}", Path(f"/proc/{main.pid}/cgroup").read_text())
        if inside is None:
            return table.get(main.parent)
        followers = [each for each in table.values() if inside[0] in each.command]
        runners = [table[each.parent] for each in followers if each.parent in table]
        return table.get(runners[0].parent) if runners else None
    return None


def format_yaml(document: object) -> str:
    """Format as YAML. JSON is YAML, except for surrogate pairs."""
    return json.dumps(document, indent=1, ensure_ascii=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgectlVariant:
    """Variant of edgectl under test.

    ``code``: directory of another edgectl package; ``connection``: how it reaches the hosts; ``sample``: one round
    of a fault that has several; ``points``: kill at so many random failpoints of a command (None: at all of them; below
    0: at so many of the last). ``swarm``: where tasks run in containers, these are services of a Docker Swarm.
    ``one_channel``: the hosts allow one channel per connection (None: those of one seed in five).
    """

    code: Path | None = None
    connection: str = "ssh"
    sample: bool = False
    points: int | None = None
    swarm: bool = False
    one_channel: bool | None = None


@dataclass(kw_only=True)
class FaultFleet:
    """Hosts, the files that describe them to edgectl, and the expected tasks."""

    directory: Path
    hosts: dict[str, Host]
    key_file: Path
    prefix: list[str]
    netns: Path | None
    random: random.Random
    mark: str = field(default_factory=lambda: f"faults-{os.urandom(6).hex()}")
    tasks: dict[str, dict[str, object]] = field(default_factory=dict)
    expected: dict[str, str | None] = field(default_factory=dict)
    inventory: dict[str, dict[str, object]] = field(default_factory=dict)
    relays: dict[str, Relay] = field(default_factory=dict)
    bystanders: list[scan.Bystander] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    overlap_allowed: set[str] = field(default_factory=set)
    coordination: str = ""
    policy: dict[str, object] = field(default_factory=dict)
    subscriber: Subscriber | None = None
    code: Path | None = None
    connection: str = "ssh"
    sample: bool = False
    points: int | None = None
    swarm: bool = False
    kill_at: int | None = None
    kill_with: signal.Signals = signal.SIGKILL
    injected: int = 0
    stack: ExitStack = field(default_factory=ExitStack)
    started_ns: int = field(default_factory=oracle.read_boottime_ns)
    outcomes: list[CommandResult] = field(default_factory=list)

    def __post_init__(self) -> None:
        for place in ("home", "state", "tmp"):
            (self.directory / place).mkdir(parents=True)
        for name in self.hosts:
            self.inventory[name] = {
                "host": name,
                "connection": self.connection,
                "capacity": {"cpu": 4, "memory": "8Gi"},
                **({"runtime": "systemd"} if self.hosts[name].kind == "systemd" else {}),
            }
        give_key(self.state, FLEET)
        self.write_files()

    # Hosts, by the order of their start

    @property
    def edges(self) -> list[str]:
        return list(self.hosts)

    @property
    def first(self) -> str:
        return self.edges[0]

    @property
    def second(self) -> str:
        return self.edges[1]

    @property
    def third(self) -> str:
        return self.edges[2]

    @property
    def engines(self) -> dict[str, ComputerEngine]:
        """The container engines, if tasks run in containers."""
        found = {name: getattr(host, "engine", None) for name, host in self.hosts.items()}
        return {name: engine for name, engine in found.items() if engine is not None}

    def list_supervisors(self, name: str, word: str = "") -> list[scan.Process]:
        """List the supervisors of the tasks on a host whose command lines have ``word``."""
        table = {each.pid: each for each in self.hosts[name].processes()}
        found = {}
        for each in table.values():
            if self.mark in each.command and word in each.command:
                above = find_supervisor(each, table)
                if above is not None and self.mark not in above.command:
                    found[above.pid] = above
        return list(found.values())

    # Expected tasks

    def add_task(self, name: str, *options: str, on: str | None = None, **fields: object) -> None:
        """Add task ``name``, pinned to host ``on``; ``options`` are those of recording_task.py."""
        words = " ".join(options)
        command = f'exec python3 "$HOME/oracle/recording_task.py" --dir "$HOME/oracle/records" --task {name} --mark {self.mark} {words}'
        entry: dict[str, object] = {
            "command": command,
            "demand": {"cpu": 0.1, "memory": "10Mi"},
            "stop": {"grace": "3s"},
            **({"image": self.build_image()} if self.engines else {}),
            **fields,
        }
        if on:
            entry["hosts"] = {"pin": on}
        self.tasks[name] = entry
        self.expected[name] = on
        self.write_files()

    def build_image(self, **more: object) -> dict[str, object]:
        """The image of a task, in which "$HOME/oracle" is that of the host."""
        engine = {"engine": "swarm"} if self.swarm else {}
        return {"name": IMAGE, "volumes": [*SYSTEM, "~/oracle:/oracle"], "pull": "never", **engine, **more}

    def pin_task(self, name: str, on: str | None) -> None:
        """Pin task ``name`` to host ``on`` (None: any host)."""
        self.tasks[name].pop("hosts", None)
        if on:
            self.tasks[name]["hosts"] = {"pin": on}
        self.expected[name] = on
        self.write_files()

    def remove_task(self, name: str) -> None:
        """Remove task ``name``."""
        del self.tasks[name], self.expected[name]
        self.write_files()

    # Files

    @property
    def state(self) -> Path:
        return self.directory / "state"

    @property
    def inventory_head(self) -> dict[str, object]:
        """What an inventory of this fleet states besides its hosts."""
        shared = {"coordination": self.coordination} if self.coordination else {}
        return {"version": 1, "fleet": FLEET, **shared}

    def write_files(self) -> None:
        """Write the files of edgectl and ssh."""
        inventory = {**self.inventory_head, "edges": self.inventory}
        (self.directory / "inventory.yaml").write_text(format_yaml(inventory))
        # The default of ``up`` would cost each start 3 s.
        tasks = {name: {"up": "300ms", **task} for name, task in self.tasks.items()}
        (self.directory / "tasks.yaml").write_text(format_yaml({"version": 1, **self.policy, "tasks": tasks}))
        self._write_ssh_files()

    def _write_ssh_files(self) -> None:
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

    def trust_host_keys(self) -> None:
        """Accept the present host keys, also on the workers of a swarm."""
        self.keys = {}
        self.write_files()
        if self.swarm:
            trust_manager(self)

    def get_relay(self, name: str) -> Relay:
        """Return the relay to host ``name``; the first call inserts it."""
        if name not in self.relays:
            address, port, *_ = self.hosts[name].login
            relay = Relay((address, port), netns=self.netns)
            relay.start()
            self.stack.callback(relay.stop)
            self.relays[name] = relay
            self.write_files()
        return self.relays[name]

    def get_computer(self, name: str) -> NamespaceHost:
        """Return host ``name``, which must be an emulated computer."""
        host = self.hosts[name]
        assert isinstance(host, NamespaceHost)
        return host

    def start_bystander(self, host: str, *words: str, pid: int = 0) -> None:
        """Start an unrelated process on the host."""
        self.bystanders.append(
            self.hosts[host].start_bystander(f"bystander{len(self.bystanders)}", *words, pid=pid)
        )

    # edgectl

    def build_env(self, **more: str) -> dict[str, str]:
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

    def build_command(self, *words: str) -> list[str]:
        """Build edgectl's command line with this fleet's files."""
        files = ["-i", str(self.directory / "inventory.yaml"), "-t", str(self.directory / "tasks.yaml")]
        program = (
            [str(EDGECTL)]
            if self.kill_at is None
            else failpoint_runner.build_command(self.failpoint_log, self.kill_at, self.kill_with)
        )
        return [*self.prefix, *program, *words, *files]

    @property
    def failpoint_log(self) -> Path:
        """Log of the failpoints hit by an edgectl with ``deadly``; see `failpoint_runner`."""
        return self.directory / "points"

    def start_edgectl(self, *words: str, **env: str) -> "subprocess.Popen[str]":
        """Start edgectl without waiting for it."""
        return self.start_command(self.build_command(*words), self.build_env(**env))

    def start_command(self, command: list[str], env: dict[str, str]) -> "subprocess.Popen[str]":
        """Start a command of `build_command`, forked unless the environment has other code or libraries for it."""
        if not env.keys() & {"PYTHONPATH", "LD_PRELOAD"}:
            own = command[len(self.prefix) :]
            program, words = (own[3], own[4:]) if "-c" in own[:3] else (forkserver.EDGECTL, own[1:])
            forked = forkserver.ForkedProcess(
                words,
                program=program,
                env=env,
                netns=str(self.netns or ""),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
            self.stack.callback(forked.end)
            return forked
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=env,
            start_new_session=True,
        )

    def wait_for_edgectl(
        self, process: "subprocess.Popen[str]", words: tuple[str, ...] = APPLY, *, begun: float | None = None
    ) -> CommandResult:
        """Wait for edgectl, at most two minutes."""
        begun = begun or time.monotonic()
        try:
            out, err = process.communicate(timeout=patience(WORST_S))
        except subprocess.TimeoutExpired as hung:
            os.killpg(process.pid, signal.SIGKILL)
            _, err = process.communicate()
            raise ExpectationError(
                f"edgectl {' '.join(words)} still runs after {WORST_S:.0f} s: {err[-300:]}"
            ) from hung
        outcome = CommandResult(
            words=words, code=process.returncode, out=out, err=err, seconds=time.monotonic() - begun
        )
        self.outcomes.append(outcome)
        if "Traceback" in outcome.err + outcome.out:
            raise ExpectationError(f"a traceback: {outcome}")
        return outcome

    def run_edgectl(self, *words: str, **env: str) -> CommandResult:
        """Run edgectl to its end."""
        begun = time.monotonic()
        return self.wait_for_edgectl(self.start_edgectl(*words, **env), words, begun=begun)

    def run_on_terminal(self, *words: str) -> str:
        """Run edgectl in a terminal; return its output."""
        ours, theirs = pty.openpty()
        done = subprocess.Popen(
            self.build_command(*words),
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=self.build_env(TERM="xterm"),
            start_new_session=True,
        )
        os.close(theirs)
        data = b""
        with os.fdopen(ours, "rb", buffering=0) as terminal, suppress(OSError):
            while part := terminal.read(65536):
                data += part
        done.wait(patience(WORST_S))
        return data.decode(errors="replace")

    def apply(self, **env: str) -> CommandResult:
        """Run apply."""
        return self.run_edgectl(*APPLY, **env)

    # Verdict

    @property
    def records(self) -> dict[str, Path]:
        return {name: host.records for name, host in self.hosts.items()}

    def judge_launches(
        self,
        expected: Mapping[str, str | None] | None = None,
        *,
        seconds: float = 0.7,
        patience: float = 12.0,
    ) -> OracleVerdict:
        """Return the oracle's verdict on present and past launches; ``expected`` replaces the expected tasks."""
        wanted = self.expected if expected is None else expected
        found = oracle.judge_launches(
            self.records,
            wanted,
            since_ns=self.started_ns,
            overlap_allowed=self.overlap_allowed,
            seconds=seconds,
            patience=patience,
        )
        harm = tuple(word for bystander in self.bystanders for word in bystander.list_harm())
        heard = self.subscriber.find_overlaps() if self.subscriber is not None else []
        return OracleVerdict(lost=found.lost, doubled=(*found.doubled, *heard), foreign=harm)

    def subscribe(self) -> Subscriber:
        """Hear the messages of the tasks from now on; two senders at once count as doubled."""
        if self.subscriber is None:
            address = "127.0.0.1" if self.netns is None else f"{self.get_computer(self.first).site.network}.1"
            self.subscriber = self.stack.enter_context(subscribe(address, self.netns))
        return self.subscriber

    def check_verdict(self, expected: Mapping[str, str | None] | None = None) -> None:
        """Require a clean verdict."""
        if not (verdict := self.judge_launches(expected)).clean:
            raise OracleError(verdict)

    def apply_and_check(self) -> None:
        """Apply once and check that everything runs as expected."""
        self.apply().expect_exit(0)
        self.check_verdict()

    def wait(self, seconds: float) -> None:
        """Wait ``seconds``."""
        time.sleep(seconds)

    def has_stopped(self, task: str) -> bool:
        """Whether the last launch of the task reported its end."""
        found = oracle.group_by_task(oracle.list_lifetimes(self.records)).get(task)
        return found[-1].stopped if found else False

    def probe_host(self, host: str) -> dict[str, Any]:
        """Return edgectl's measurement of the host."""
        hosts = self.run_edgectl("probe", "-o", "json").expect_exit(0, 4).data["hosts"]
        assert isinstance(hosts, dict)
        return dict(hosts[host])

    def count_launches(self, task: str) -> int:
        """Count the starts of the task."""
        return len(oracle.group_by_task(oracle.list_lifetimes(self.records)).get(task, []))

    def find_leftovers(self) -> OracleVerdict:
        """Find leftovers after a full stop: processes, containers, held locks, files that others may read.

        A host removes dead containers beside a command, which takes it a moment.
        """
        deadline = time.monotonic() + (patience(REMOVAL_S) if self.engines else 0.0)
        while (left := self._list_leftovers()) and time.monotonic() < deadline:
            time.sleep(0.2)
        return OracleVerdict(left=tuple(sorted(set(left))))

    def _list_leftovers(self) -> list[str]:
        left = [
            f"{name}: process {each.pid} {each.command[:90]}"
            for name, host in self.hosts.items()
            for each in host.processes()
        ]
        left += [f"process {each.pid} {each.command[:90]}" for each in scan.list_marked_processes(self.mark)]
        places = [
            path for host in self.hosts.values() for path in (host.home / ".local", host.home / "state")
        ]
        left += [
            f"temporary file {path}" for path in scan.list_files(self.state, *places) if path.suffix == ".tmp"
        ]
        left += [line for engine in self.engines.values() for line in engine.find_left()]
        left += list_left_services(self) if self.swarm else []
        left += scan.list_held_locks(self.state, *places)
        left += [
            f"open to others: {path}"
            for path in scan.list_exposed_paths(
                self.state / "fleets", *(place / "edgectl" for place in places)
            )
        ]
        return left


class OracleError(AssertionError):
    """The oracle found a violation."""

    def __init__(self, verdict: OracleVerdict) -> None:
        super().__init__(str(verdict))
        self.verdict = verdict


def repair_fleet(fleet: FaultFleet) -> None:
    """Restore power, cables, relays, disks and logins. Host keys stay as they are."""
    for relay in fleet.relays.values():
        relay.heal()
    for host in fleet.hosts.values():
        if isinstance(host, NamespaceHost) and host.pid:
            host.plug_in_cable()
            host.free_disk()
            host.home_read_only(yes=False)
        host.boot()
        host.allow_logins(allowed=True)
    for engine in fleet.engines.values():
        engine.start()
    if fleet.swarm:
        await_nodes(fleet)


def draw_one_channel(seed: int) -> bool:
    """Draw whether the hosts allow one channel per connection."""
    return random.Random(f"channels {seed}").random() < 1 / 5


@contextmanager
def open_fleet(
    kind: str,
    directory: Path,
    names: list[str],
    seed: int,
    variant: "EdgectlVariant | None" = None,
    *,
    shared: Mapping[str, Path] | None = None,
) -> Iterator[FaultFleet]:
    """Open a fleet of hosts of one kind; clean up at the end. ``shared``: directories of this machine that
    computers in namespaces have too.
    """
    variant = variant or EdgectlVariant()
    with ExitStack() as stack:
        prefix: list[str] = []
        netns = None
        if kind != "loopback":
            # For every second seed, the engines end their containers as they come back; in a swarm they always do.
            live = random.Random(f"engine {seed}").random() < 0.5 if kind == "containers" else None
            live = live and not variant.swarm
            made = start_namespace_hosts(
                directory / "hosts", names, systemd=kind == "systemd", live_restore=live, shared=shared
            )
            site, hosts = stack.enter_context(made)
            prefix, netns = site.prefix, site.netns
        else:
            hosts = stack.enter_context(start_loopback_hosts(directory / "hosts", names))
        fleet = FaultFleet(
            directory=directory / "manager",
            hosts=hosts,
            key_file=directory / "hosts" / "user_key",
            prefix=prefix,
            netns=netns,
            random=random.Random(seed),
            stack=stack,
            code=variant.code,
            connection=variant.connection,
            sample=variant.sample,
            points=variant.points,
            swarm=variant.swarm,
        )
        if draw_one_channel(seed) if variant.one_channel is None else variant.one_channel:
            for host in hosts.values():
                host.set_server_options("MaxSessions 1")
        if variant.swarm:
            form_swarm(fleet)
        stack.callback(lambda: scan.kill_processes(scan.list_marked_processes(fleet.mark)))
        yield fleet
