# SPDX-License-Identifier: Apache-2.0
# Hosts may have Python 3.6, so:
"""Unrelated process that records every signal it receives, and the sender.

Started on a host beside the tasks, with a command line that resembles theirs. Python >= 3.6, standard
library.

Usage: bystander.py RECORD-FILE [words that make it resemble something else]
"""

import json
import os
import signal
import sys
import time

BOOTTIME = 7
DEADLY = {signal.SIGKILL, signal.SIGSTOP}


def write_event(record: int, event: str, **more: object) -> None:
    line = dict(more, pid=os.getpid(), event=event, ns=int(time.clock_gettime(BOOTTIME) * 1e9))
    os.write(record, (json.dumps(line) + "\n").encode())


def main(path: str) -> None:
    watched = set(signal.Signals) - DEADLY
    signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    record = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    write_event(record, "start")
    while True:
        heard = signal.sigwaitinfo(watched)
        write_event(record, signal.Signals(heard.si_signo).name, sender=heard.si_pid, uid=heard.si_uid)


if __name__ == "__main__":
    main(sys.argv[1])
