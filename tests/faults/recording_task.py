# SPDX-License-Identifier: Apache-2.0
# Hosts may have Python 3.6, so:
# ruff: noqa: PTH100, PTH109, PTH110, PTH118, PTH123, RUF005, UP030, UP032
"""Task that records its own life: every process appends its events to a file of its own.

Runs on hosts: Python >= 3.6, standard library, one file, no import of edgectl. One start of the task is a
*launch*; a launch has a main process and, on request, further processes that are hard to stop. A line is one
JSON object, written with one ``O_APPEND`` write: ``{"task", "launch", "role", "pid", "cookie", "event",
"ns"}``; ``event`` is start, tick, stop or a signal's name; ``ns`` is CLOCK_BOOTTIME, the same in every
namespace of one machine; ``cookie`` is the instance id that edgectl put into the environment.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time

BOOTTIME = 7  # Python 3.6 has no time.CLOCK_BOOTTIME
ROLES = ("child", "daemon", "session")


def parse_arguments(argv: "list[str]") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--dir", required=True, help="directory of the records")
    parser.add_argument("--task", required=True)
    parser.add_argument(
        "--mark", required=True, help="word by which a scan of /proc finds every process of ours"
    )
    parser.add_argument("--period", type=float, default=0.03, help="seconds between ticks")
    parser.add_argument("--with", dest="roles", default="", help="further processes: " + ",".join(ROLES))
    parser.add_argument(
        "--bare", action="store_true", help="the further processes run with an empty environment"
    )
    parser.add_argument(
        "--closed", action="store_true", help="the further processes close what they inherited"
    )
    parser.add_argument(
        "--detach", action="store_true", help="the main process ends once the further ones run"
    )
    parser.add_argument(
        "--deaf", action="store_true", help="TERM, INT and HUP are noted and otherwise ignored"
    )
    parser.add_argument(
        "--for", dest="seconds", type=float, default=0, help="end by itself after this time; 0: never"
    )
    parser.add_argument("--exit", dest="code", type=int, default=0, help="exit code at that end")
    parser.add_argument("--spam", type=float, default=0, help="bytes per second written to stdout")
    parser.add_argument(
        "--garbage", action="store_true", help="write bytes that are no UTF-8, NULs and no newline to stdout"
    )
    parser.add_argument(
        "--touch", default="", help="file made once the task is ready (after --after seconds)"
    )
    parser.add_argument("--after", type=float, default=0)
    parser.add_argument("--launch", default="")
    parser.add_argument("--role", default="main")
    parser.add_argument("rest", nargs="*", help="ignored; recorded with the start")
    return parser.parse_args(argv)


class EventFile:
    """Event file of one process."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.head = {
            "task": options.task,
            "launch": options.launch,
            "role": options.role,
            "pid": os.getpid(),
            "cookie": os.environ.get("EDGECTL_INSTANCE", ""),
        }
        name = "{0}.{1}.{2}.jsonl".format(options.launch, options.role, os.urandom(3).hex())
        self.file = os.open(os.path.join(options.dir, name), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)

    def write(self, event: str, **more: object) -> None:
        line = dict(self.head, event=event, ns=int(time.clock_gettime(BOOTTIME) * 1e9), **more)
        os.write(self.file, (json.dumps(line) + "\n").encode())


def start_process(options: argparse.Namespace, argv: "list[str]", role: str) -> None:
    """Start one further process of this launch."""
    command = (
        [sys.executable, os.path.abspath(__file__)] + argv + ["--launch", options.launch, "--role", role]
    )
    command = [word for word in command if word != "--detach"]
    environment = {} if options.bare else dict(os.environ)
    if role == "daemon":  # double fork of a daemon
        if os.fork():
            os.wait()
            return
        os.setsid()
        if os.fork():
            os._exit(0)
    elif role == "session" and os.fork():
        return
    elif role == "session":
        os.setsid()
    if role == "child":
        subprocess.Popen(command, env=environment, close_fds=options.closed)
        return
    if options.closed:
        null = os.open(os.devnull, os.O_RDWR)
        for number in range(3):
            os.dup2(null, number)
        os.closerange(3, 4096)
    os.execve(sys.executable, command, environment)


def record_signals(options: argparse.Namespace, record: EventFile, state: "dict[str, bool]") -> None:
    def heard(number: int, _frame: object) -> None:
        record.write(signal.Signals(number).name)
        if not options.deaf:
            state["end"] = True

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, heard)


def write_output(options: argparse.Namespace) -> None:
    """Write the requested output of one period."""
    if options.garbage:
        os.write(1, b"\xff\xfe\x00\xc3\x28\x1b]0;owned\x07\x9b31m" + os.urandom(32))
    count = int(options.spam * options.period)
    if count:
        os.write(1, (b"spam" * 20 + b"\n") * max(1, count // 81))


def run_main_process(options: argparse.Namespace, record: EventFile) -> int:
    state = {"end": False}
    record_signals(options, record, state)
    begun = time.monotonic()
    if options.role == "main" and options.touch and options.after == 0:
        open(options.touch, "w").close()
    while not state["end"]:
        age = time.monotonic() - begun
        if options.role == "main" and options.seconds and age >= options.seconds:
            record.write("stop", code=options.code)
            return int(options.code)
        if (
            options.role == "main"
            and options.touch
            and age >= options.after
            and not os.path.exists(options.touch)
        ):
            open(options.touch, "w").close()
        record.write("tick")
        if options.role == "main":
            write_output(options)
        time.sleep(options.period)
    record.write("stop")
    return 0


def main(argv: "list[str]") -> int:
    if "LD_PRELOAD" in os.environ:  # the records need an unskewed clock
        environment = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
        os.execve(sys.executable, [sys.executable, os.path.abspath(__file__)] + argv, environment)
    options = parse_arguments(argv)
    options.launch = options.launch or os.urandom(6).hex()
    record = EventFile(options)
    record.write(
        "start",
        rest=options.rest,
        cwd=os.getcwd(),
        environment=sorted(os.environ) if options.role == "main" else [],
    )
    if options.role == "main":
        for role in filter(None, options.roles.split(",")):
            start_process(options, argv, role)
        if options.detach:
            record.write("stop")
            return 0
    return run_main_process(options, record)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
