# SPDX-License-Identifier: Apache-2.0
"""A Slurm cluster of one node, of Debian's daemons, in a directory of the test."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

_CONFIG = """ClusterName=edgectl
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthType=auth/munge
AuthInfo=socket={here}/munge.socket
SlurmUser=root
SlurmdUser=root
StateSaveLocation={here}/state
SlurmdSpoolDir={here}/spool
SlurmctldPidFile={here}/slurmctld.pid
SlurmdPidFile={here}/slurmd.pid
SlurmctldLogFile={here}/slurmctld.log
SlurmdLogFile={here}/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
MailProg=/bin/true
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def find_ports(count: int) -> list[int]:
    """Ports of the loopback that are free now."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()


@pytest.fixture
def slurm(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of a cluster of one node; its daemons end with the test."""
    here = tmp_path / "slurm"
    here.mkdir(mode=0o755)
    (here / "munge.key").write_bytes(os.urandom(128))
    (here / "munge.key").chmod(0o600)
    host = socket.gethostname().partition(".")[0]
    text = _CONFIG.format(host=host, here=here, ports=find_ports(2), cores=os.cpu_count())
    (here / "slurm.conf").write_text(text)
    environment = {**os.environ, "SLURM_CONF": str(here / "slurm.conf")}
    environment["PATH"] += ":/usr/sbin:/sbin"
    munge = [f"--{name}={here}/munge.{name[:3]}" for name in ("pid-file", "log-file", "seed-file")]
    daemons = [
        [
            "munged",
            "--foreground",
            "--force",
            f"--socket={here}/munge.socket",
            f"--key-file={here}/munge.key",
            *munge,
        ],
        ["slurmctld", "-D", "-i"],
        ["slurmd", "-D"],
    ]
    started: list[subprocess.Popen[bytes]] = []
    try:
        for command in daemons:
            with (here / f"{command[0]}.out").open("wb") as log:
                started.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
            time.sleep(1.0)
        wait_for_idle_node(environment, here)
        yield environment
    finally:
        for daemon in reversed(started):
            daemon.terminate()
        for daemon in started:
            try:
                daemon.wait(20)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait()


def wait_for_idle_node(environment: dict[str, str], here: Path) -> None:
    """Wait until the node takes jobs."""
    sinfo = shutil.which("sinfo", path=environment["PATH"])
    assert sinfo is not None, "run .ci/need-engines"
    for _ in range(120):
        said = subprocess.run(
            [sinfo, "-h", "-o", "%t"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        if said.stdout.strip() == "idle":
            return
        time.sleep(0.5)
    logs = "\n".join(f"{path.name}: {path.read_text()[-2000:]}" for path in here.glob("*.[lo][ou][gt]"))
    pytest.fail(f"the node of Slurm takes no jobs: {said.stdout}{said.stderr}\n{logs}")
