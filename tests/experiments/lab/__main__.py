# SPDX-License-Identifier: Apache-2.0
"""``make experiment``: the shipped experiment on hosts of its own, its table, its page and its figures.

    python -m tests.experiments.lab [--out runs/patrol] [--repetitions 3] [--policies local,static,utility] [--plain]
    python -m tests.experiments.lab --profile        what each task of one mission used, for the demands in tasks.yaml

Stopped at any point, the same command goes on with the trials that are missing, on computers of the same addresses. Whatever happens,
the hosts and all that ran on them are gone at the end.
"""

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path

import yaml

from edgectl.errors import ExitCode
from tests.experiments.lab.disturbances import BUSY_CORES, COUNTED, set_disturbed_aside
from tests.experiments.lab.hosts import Lab, lab, spent
from tests.experiments.lab.machine import FILE_NAME, measure_busy, watch_machine
from tests.experiments.lab.patrol import ROOT
from tests.experiments.lab.spec import shortened
from tests.faults.namespace_host import NamespaceHost

# A trial takes the limit of the experiment file at most, then the fleet is cleared.
TRIAL_LIMIT_S, OTHER_LIMIT_S = 6 * 60, 45 * 60
# What was set aside is run again, so often.
ROUNDS = 3
IDLE_S = 10.0
# What a task uses in its first ten seconds is no sample of its demand.
SETTLE_S, WINDOWS = 8.0, 5


def edgectl(*words: str, prefix: list[str], env: dict[str, str], limit_s: float = OTHER_LIMIT_S) -> int:
    """Run one command to its end; told to end, we tell it, and give it a minute to stop what it started.

    Killed, we take it with us as we do the hosts: it would write trials of lost hosts beside those of the next run.
    """
    sys.stdout.flush()
    running = subprocess.Popen(
        ["setpriv", "--pdeathsig", "KILL", *prefix, sys.executable, "-m", "edgectl", *words],
        env=env,
        cwd=ROOT,
        start_new_session=True,
    )
    try:
        return running.wait(limit_s)
    except KeyboardInterrupt:
        running.send_signal(signal.SIGINT)
        return running.wait(60)
    finally:
        if running.poll() is None:
            running.kill()
            running.wait()


def run(made: Lab, out: Path, repetitions: int, policies: str) -> int:
    """All trials, the table, the page, the figures."""
    spec = made.site / "experiment.yaml"
    text = shortened(spec.read_text(), repetitions=repetitions, policies=policies)
    spec.write_text(text)
    words = ["experiment", "run", str(spec), "--out", str(out)]
    trials = repetitions * len(json.loads(text)["schemes"]["policies"])
    for _ in range(ROUNDS):
        with watch_machine(out / FILE_NAME, made.read_cpu_s) if made.groups else nullcontext():
            code = edgectl(
                *words, prefix=made.prefix, env=made.environment, limit_s=TRIAL_LIMIT_S * (trials + 1)
            )
        if code not in (ExitCode.DONE, ExitCode.PARTLY):
            return code
        aside = set_disturbed_aside(out) if repetitions >= COUNTED else []
        if not aside:
            break
        print("set aside, and run again:", *aside, sep="\n  ", flush=True)
    else:
        print("not complete: run the same command again on an idle machine", file=sys.stderr)
        return ExitCode.FAILED
    figures = ["--figures", str(out / "figures")]
    return edgectl("report", str(out), *figures, prefix=[], env=made.environment) or code


def profile(made: Lab) -> int:
    """What edgectl itself uses on each host; then one mission, and what its tasks were seen to use over windows of some seconds."""
    files = ["-i", str(made.site / "fleet.yaml"), "-t", str(made.site / "tasks.yaml")]
    computers = [host for host in made.hosts.values() if isinstance(host, NamespaceHost)]
    before, began = {host.name: spent(host) for host in computers}, time.monotonic()
    edgectl("watch", "--every", "5s", "--cycles", "10", *files, prefix=made.prefix, env=made.environment)
    for host in computers:
        print(
            f"{host.name}: a watch every 5 s uses {(spent(host) - before[host.name]) / (time.monotonic() - began):.3f} cores"
        )
    edgectl("apply", "--yes", *files, prefix=made.prefix, env=made.environment)
    time.sleep(SETTLE_S)
    for _ in range(WINDOWS):
        edgectl("probe", "--window", "4s", "-o", "name", *files, prefix=made.prefix, env=made.environment)
    tasks = yaml.safe_load((made.site / "tasks.yaml").read_text())["tasks"]
    return max(edgectl("profile", task, *files, prefix=[], env=made.environment) for task in tasks)


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description="The shipped experiment on hosts of its own.")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "patrol", help="where the run is kept")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--policies", default="", help="such as local,utility; all where not given")
    parser.add_argument(
        "--plain",
        action="store_true",
        help="plain SSH servers, even where computers with CPU limits could be had",
    )
    parser.add_argument(
        "--profile", action="store_true", help="no trials: what each task of one mission uses"
    )
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    counted = args.repetitions >= COUNTED and not args.profile
    if counted and (busy := measure_busy(IDLE_S)) > BUSY_CORES:
        sys.exit(f"other processes use {busy:.2f} cores: {COUNTED} repetitions need an idle machine")
    directory = Path(tempfile.mkdtemp(prefix="edgectl-experiment-"))
    try:
        with lab(directory, plain=args.plain) as made:
            print(f"hosts: {made.real}")
            if made.wanting:
                print(f"not as on real hosts: {made.wanting}")
            if made.wanting and counted:
                sys.exit(f"{COUNTED} repetitions need computers with CPU limits and shaped links")
            return profile(made) if args.profile else run(made, args.out, args.repetitions, args.policies)
    finally:
        shutil.rmtree(directory, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
