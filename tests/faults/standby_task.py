# SPDX-License-Identifier: Apache-2.0
# Hosts may have Python 3.6, so:
# ruff: noqa: PTH103, PTH110, PTH118, UP030
"""Task with standby copies that records when it is active: each activity is a launch of its own for the oracle.

Runs on hosts: Python >= 3.6, standard library, one file. Words come through a FIFO and are answered through another one
once they have taken effect: ``wake``, ``sleep``, ``tell`` (its memory: how often it has worked), ``take NUMBER``. The
first and the last line of an activity prove it; an overlap of two activities is never an artefact of a slow machine.
Each line is also a message to the subscriber, which says who sends it and when.
"""

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time

BOOTTIME = 7  # Python 3.6 has no time.CLOCK_BOOTTIME
PERIOD_S = 0.03


class Activity:
    """Record file of one activity, and the subscriber to its messages."""

    def __init__(self, folder: str, task: str, subscriber: "tuple[str, int]", count: int) -> None:
        self.head = {
            "task": task,
            "launch": os.urandom(6).hex(),
            "role": "main",
            "pid": os.getpid(),
            "cookie": os.environ.get("EDGECTL_INSTANCE", ""),
        }
        self.subscriber = subscriber
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        name = "{0}.main.{1}.jsonl".format(self.head["launch"], os.urandom(3).hex())
        self.file = os.open(os.path.join(folder, name), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        self.write("start", count)

    def write(self, event: str, count: int) -> None:
        ns = int(time.clock_gettime(BOOTTIME) * 1e9)
        os.write(self.file, (json.dumps(dict(self.head, event=event, ns=ns, count=count)) + "\n").encode())
        with contextlib.suppress(OSError):  # the cable is unplugged: the record remains
            self.socket.sendto("{0} {1}".format(self.head["launch"], ns).encode(), self.subscriber)

    def end(self, count: int) -> None:
        self.write("stop", count)
        self.socket.close()
        os.close(self.file)


def open_pipe(folder: str, name: str) -> int:
    path = os.path.join(folder, name)
    if not os.path.exists(path):
        os.mkfifo(path, 0o600)
    return os.open(path, os.O_RDWR | os.O_NONBLOCK)


def run_task(records: str, task: str, pipes: str, subscriber: "tuple[str, int]") -> None:
    os.makedirs(pipes, exist_ok=True)
    control, answers = open_pipe(pipes, "in"), open_pipe(pipes, "out")
    ended = []  # type: list[int]
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda heard, _frame: ended.append(heard))
    activity, count = None, 0
    while not ended:
        heard = select.select([control], [], [], PERIOD_S)[0]
        if heard:
            word, _, value = os.read(control, 64).decode().splitlines()[-1].partition(" ")
            answer = word
            if word == "wake" and activity is None:
                activity = Activity(records, task, subscriber, count)
            elif word == "sleep" and activity is not None:
                activity.end(count)
                activity = None
            elif word == "tell":
                answer = str(count)
            elif word == "take":
                count = int(value)
            os.write(answers, (answer + "\n").encode())
        if activity is not None:
            count += 1
            activity.write("tick", count)
    if activity is not None:
        activity.end(count)


if __name__ == "__main__":
    run_task(sys.argv[1], sys.argv[2], sys.argv[3], (sys.argv[4], int(sys.argv[5])))
