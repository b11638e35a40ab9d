# SPDX-License-Identifier: Apache-2.0
"""What the machine does beside an experiment, and what the evaluation says of it."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

from edgectl.experiments.files.run_directory import RUN_FILE_NAME, load_run
from tests.docs import evaluation
from tests.experiments.lab.machine import (
    FILE_NAME,
    MachineSample,
    compute_others,
    load_samples,
    read_busy_s,
    watch_machine,
)
from tests.pace import patience

_BURN = "import time\nwhile time.process_time() < 0.5: pass"


def test_the_machine_counts_what_a_process_uses() -> None:
    before = read_busy_s()
    subprocess.run([sys.executable, "-I", "-S", "-c", _BURN], check=True)
    assert read_busy_s() - before >= 0.48


def test_a_watch_leaves_samples_until_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "run" / FILE_NAME
    assert load_samples(path) == []
    with watch_machine(path, time.monotonic, every_s=0.05):
        time.sleep(0.15)
        assert not path.parent.exists(), "a run begins in an empty directory"
        path.parent.mkdir()
        time.sleep(0.15)
        assert not path.exists(), "its own file comes first, else it would not begin again after a kill"
        (path.parent / RUN_FILE_NAME).touch()
        deadline = time.monotonic() + patience(20)
        while len(load_samples(path)) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    found = load_samples(path)
    assert abs(found[-1].at - time.time()) < patience(20)
    # A thread that is held up between its two readings is off by that.
    median = sorted(each.own for each in found)[len(found) // 2]
    assert 0.5 < median < 2.0, "a second of CPU each second, as the test says; in another unit it were 0.05"
    time.sleep(0.15)
    assert load_samples(path) == found


def test_the_evaluation_says_what_others_used() -> None:
    """Of three repetitions, the second was disturbed; a little is used at all times."""
    run = load_run(evaluation.RUN)
    (first, *_) = run.trials
    trials = tuple(replace(first, repetition=n, began_at=1000.0 * n, latency=100.0) for n in (3, 1, 2))
    samples = [
        MachineSample(at=1000.0 * n + at, busy=1.5 + extra, own=1.48)
        for n, extra in ((1, 0.0), (2, 0.4), (3, 0.02))
        for at in (-5.0, 5.0, 50.0, 105.0)
    ]
    samples[0] = MachineSample(at=995.0, busy=2.0, own=0.0)
    assert compute_others(samples, 1000.0, 1100.0) is not None
    assert round(compute_others(samples, 1000.0, 1100.0) or 0.0, 6) == 0.02, "those within it alone"
    assert compute_others(samples, 5000.0, 5100.0) is None
    said = evaluation.describe_machine(replace(run, trials=trials), samples)
    assert said == (
        "Other processes of the machine used 0.02 to 0.42 cores on average in a repetition, above 0.1 in repetition 2."
    )
    assert "not recorded" in evaluation.describe_machine(run, [])
    assert MachineSample(at=0.0, busy=1.0, own=1.2).others == 0.0
