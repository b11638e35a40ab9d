# SPDX-License-Identifier: Apache-2.0
"""Whole processes that ask N real hosts, from the start of Python to the exit: ``python -m
tests.benchmarks.whole_commands [N ..]``.

``edgectl probe`` against one command (``true``) on the same hosts by tuned paramiko, by a group of Fabric and by
parallel ``ssh`` processes; and the agent of edgectl with the input of a probe by ``ssh``. All verify host keys, log
in with one key and have at most 32 hosts at a time. They run in turns.
"""

import getpass
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from edgectl.model.inventory import Inventory
from edgectl.transport import agent_client
from tests.benchmarks.probe_fanout import record_request
from tests.benchmarks.ratios import note_ratio
from tests.sshd import Lab, running_lab

SIZES = (3, 16, 64)
AT_ONCE = 32
# Of the whole process, by N: seconds at most, and a multiple of tuned paramiko.
MOST_S, MOST_RATIO = {3: 0.25}, {64: 1.5}
SSH = "ssh -o BatchMode=yes -o KexAlgorithms=curve25519-sha256 -o LogLevel=ERROR"
# Arguments of both: hosts at a time, known_hosts, key file, user, then address:port of each host.
COMMON = """
import base64, socket, sys
from concurrent.futures import ThreadPoolExecutor
most, known_hosts, key_file, user, *places = sys.argv[1:]
most = int(most)
places = [(place.rpartition(":")[0], int(place.rpartition(":")[2])) for place in places]
known = {line.split()[0]: line.split()[2] for line in open(known_hosts)}
"""
PARAMIKO = (
    COMMON
    + """
import paramiko
key = paramiko.Ed25519Key.from_private_key_file(key_file)
class Line(socket.socket):
    def recv(self, size, flags=0):
        data = super().recv(size, flags)
        self.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return data
def ask(place):
    line = Line(socket.AF_INET, socket.SOCK_STREAM)
    line.connect(place)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
    transport = paramiko.Transport(line)
    options = transport.get_security_options()
    options.kex = [name for name in options.kex if name.startswith("curve25519")]
    transport.start_client(timeout=60)
    shown = transport.get_remote_server_key()
    assert known["[%s]:%d" % place] == shown.get_base64()
    transport.auth_publickey(user, key)
    channel = transport.open_session()
    channel.exec_command("true")
    assert channel.recv_exit_status() == 0
    line.shutdown(socket.SHUT_RDWR)
    transport.close()
with ThreadPoolExecutor(most) as pool:
    assert len(list(pool.map(ask, places))) == len(places)
"""
)
FABRIC = (
    COMMON
    + """
import fabric, paramiko
options = {"key_filename": key_file, "allow_agent": False, "look_for_keys": False}
def connect(place):
    config = fabric.Config(ssh_config=paramiko.SSHConfig())
    connection = fabric.Connection(place[0], user=user, port=place[1], connect_kwargs=options, config=config)
    connection.client.load_host_keys(known_hosts)
    connection.client.set_missing_host_key_policy(paramiko.RejectPolicy())
    return connection
for start in range(0, len(places), most):
    with fabric.ThreadingGroup.from_connections(map(connect, places[start : start + most])) as group:
        assert all(result.ok for result in group.run("true", hide=True).values())
"""
)


def build_runs(lab: Lab, names: Sequence[str], folder: Path) -> dict[str, Callable[[], None]]:
    """Return what is compared, the reference first."""
    environment = os.environ | lab.environment | {"EDGECTL_STATE_DIR": str(folder / "state")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    servers = [lab[name] for name in names]
    arguments = [str(AT_ONCE), str(lab.known_hosts), str(lab.user_key), getpass.getuser()]
    arguments += [f"{server.address}:{server.port}" for server in servers]
    write_inventory(folder, names)
    stdin = folder / "stdin"
    stdin.write_bytes(record_request(Inventory(hosts={name: lab.host(name) for name in names})))

    def run(*command: str, text: str = "") -> None:
        done = subprocess.run(
            command, cwd=folder, env=environment, input=text, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (command[0], done.stderr[-2000:])

    def run_ssh(command: str, source: str) -> None:
        script = f'exec {SSH} -F {lab.ssh_config} "$1" "{command}" < {source}'
        run("xargs", "-P", str(AT_ONCE), "-n", "1", "sh", "-c", script, "sh", text="\n".join(names))

    agent = agent_client.build_agent_command("python3").replace('"', '\\"')
    return {
        "tuned paramiko": lambda: run(sys.executable, "-c", PARAMIKO, *arguments),
        "ssh": lambda: run_ssh("true", "/dev/null"),
        "Fabric": lambda: run(sys.executable, "-c", FABRIC, *arguments),
        "ssh, agent": lambda: run_ssh(agent, str(stdin)),
        "edgectl probe": lambda: run(
            sys.executable, "-m", "edgectl", "probe", "--window", "0", "--timeout", "2m"
        ),
    }


def write_inventory(folder: Path, names: Sequence[str]) -> None:
    (folder / "inventories").mkdir(exist_ok=True)
    edges = "".join(f"  {name}: {{host: {name}}}\n" for name in names)
    (folder / "inventories" / "lab.yaml").write_text(f"version: 1\nfleet: whole\nedges:\n{edges}")


def measure_row(lab: Lab, names: Sequence[str], folder: Path) -> bool:
    """Measure and print one N; return whether its goals are met."""
    runs = build_runs(lab, names, folder)
    took: dict[str, list[float]] = {what: [] for what in runs}
    for turn in range(-1, 9 if len(names) <= 16 else 5):
        for what, run in runs.items():
            began = time.perf_counter()
            run()
            if turn >= 0:
                took[what].append(time.perf_counter() - began)
    ours = took["edgectl probe"]
    ratios = {
        what: statistics.median(mine / other for mine, other in zip(ours, times, strict=True))
        for what, times in took.items()
    }
    seconds = "".join(f"{statistics.median(times):>16.3f}" for times in took.values())
    print(f"{len(names):>5}{seconds}")
    print(f"{'':>5}{''.join(f'{ratio:>16.2f}' for ratio in ratios.values())}", flush=True)
    for what, ratio in ratios.items():
        if what != "edgectl probe":
            most = MOST_RATIO.get(len(names)) if what == "tuned paramiko" else None
            note_ratio(f"whole probe of {len(names)} hosts", ratio, of=what, most=most)
    for most_s in (MOST_S[size] for size in MOST_S if size == len(names)):
        note_ratio(
            f"whole probe of {len(names)} hosts", statistics.median(ours) / most_s, of=f"{most_s} s", most=1.0
        )
    in_time = statistics.median(ours) <= MOST_S.get(len(names), float("inf"))
    return in_time and ratios["tuned paramiko"] <= MOST_RATIO.get(len(names), float("inf"))


def main(words: Sequence[str]) -> int:
    """Print the table; return 1 if a goal is missed."""
    sizes = [int(word) for word in words] or list(SIZES)
    columns = ("tuned paramiko", "ssh", "Fabric", "ssh, agent", "edgectl probe")
    print("whole processes that ask N hosts: medians, s, and edgectl as a multiple of each")
    print(f"{'N':>5}{''.join(f'{column:>16}' for column in columns)}")
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
        folder = Path(directory)
        with running_lab(folder / "lab", [f"edge{n}" for n in range(1, max(sizes) + 1)]) as lab:
            os.environ.update(lab.environment)
            met = [measure_row(lab, list(lab.servers)[:size], folder) for size in sizes]
    print(f"goals: 3 hosts in {MOST_S[3]} s, 64 in {MOST_RATIO[64]} times tuned paramiko")
    return int(not all(met))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
