# SPDX-License-Identifier: Apache-2.0
"""Worlds of a sweep on a Slurm cluster: a job for each shard, on a file system that all see."""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from edgectl.errors import EdgectlError, UsageError

# Slurm's default of MaxArraySize is 1001.
MAX_ARRAY = 1000


def submit_shards(spec: Path, out: Path, shards: int) -> None:
    """Submit one job for each shard and wait for all; the jobs write their results into ``out``.

    Raises:
        UsageError: there is no sbatch.
        EdgectlError: Slurm refuses the jobs, or one of them failed.
    """
    sbatch = shutil.which("sbatch")
    if sbatch is None:
        raise UsageError("sbatch not found", hint="run this where jobs of Slurm are submitted")
    logs = out.resolve() / "slurm-%A-%a.log"
    command = [sbatch, "--parsable", "--wait", f"--array=1-{shards}", "--ntasks=1", "--cpus-per-task=1"]
    command += ["--job-name=edgectl-sweep", f"--output={logs}"]
    words = ["simulate", "sweep", str(spec.resolve()), "--out", str(out.resolve()), "--workers", "1"]
    done = subprocess.run(
        command, input=_build_script(words, shards), capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        job = done.stdout.strip().partition(";")[0]
        message = said[-1] if said else f"a job of the array {job} failed"
        raise EdgectlError(f"Slurm: {message}", hint=f"see {out}/slurm-*.log; repeat the command to resume")


def _build_script(words: Sequence[str], shards: int) -> str:
    """A program in Python, so that no shell reads the names of files."""
    return (
        f"#!{sys.executable}\n"
        "import os, sys\n"
        f"sys.path.insert(0, {json.dumps(str(Path(__file__).resolve().parents[2]))})\n"
        "if __name__ == '__main__':  # a worker imports this once more\n"
        "    from edgectl.cli.main import main\n"
        f"    shard = os.environ['SLURM_ARRAY_TASK_ID'] + '/{shards}'\n"
        f"    sys.exit(main([*{json.dumps(list(words))}, '--shard', shard]))\n"
    )
