# SPDX-License-Identifier: Apache-2.0
# Hosts may have Python 3.6, so:
# ruff: noqa: PTH103, PTH110, PTH118, UP030
"""Task with standby copies that records when it is active: each activity is a launch of its own for the oracle.

Runs on hosts: Python >= 3.6, standard library, one file. ``wake`` and ``sleep`` come through a FIFO and are answered
through another one once they have taken effect. The first and the last line of an activity prove it; an overlap of
two activities is never an artefact of a slow machine.
"""

import json
import os
import select
import signal
import sys
import time

BOOTTIME = 7  # Python 3.6 has no time.CLOCK_BOOTTIME
PERIOD_S = 0.03


class Activity:
    """Record file of one activity."""

    def __init__(self, folder: str, task: str) -> None:
        self.head = {
            "task": task,
            "launch": os.urandom(6).hex(),
            "role": "main",
            "pid": os.getpid(),
            "cookie": os.environ.get("EDGECTL_INSTANCE", ""),
        }
        name = "{0}.main.{1}.jsonl".format(self.head["launch"], os.urandom(3).hex())
        self.file = os.open(os.path.join(folder, name), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        self.write("start")

    def write(self, event: str) -> None:
        line = dict(self.head, event=event, ns=int(time.clock_gettime(BOOTTIME) * 1e9))
        os.write(self.file, (json.dumps(line) + "\n").encode())

    def end(self) -> None:
        self.write("stop")
        os.close(self.file)


def open_pipe(folder: str, name: str) -> int:
    path = os.path.join(folder, name)
    if not os.path.exists(path):
        os.mkfifo(path, 0o600)
    return os.open(path, os.O_RDWR | os.O_NONBLOCK)


def run_task(records: str, task: str, pipes: str) -> None:
    os.makedirs(pipes, exist_ok=True)
    control, answers = open_pipe(pipes, "in"), open_pipe(pipes, "out")
    ended = []  # type: list[int]
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda heard, _frame: ended.append(heard))
    activity = None
    while not ended:
        heard = select.select([control], [], [], PERIOD_S)[0]
        if heard:
            word = os.read(control, 64).split()[-1]
            if word == b"wake" and activity is None:
                activity = Activity(records, task)
            elif word == b"sleep" and activity is not None:
                activity.end()
                activity = None
            os.write(answers, word + b"\n")
        if activity is not None:
            activity.write("tick")
    if activity is not None:
        activity.end()


if __name__ == "__main__":
    run_task(*sys.argv[1:4])
