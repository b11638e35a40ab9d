# SPDX-License-Identifier: Apache-2.0
"""A subscriber of ROS 2 in a process of its own: the Python of the tests has no rclpy."""

import os
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.handoffs.ros_node import TOPIC
from tests.handoffs.subscriber import Subscriber
from tests.views.fixtures import ROOT

PYTHON = ROOT / ".venv-ros2" / "bin" / "python3"
LISTENER = Path(__file__).with_name("ros_listener.py")


@contextmanager
def hear_ros(domain: int, prefix: Sequence[str] = ()) -> Iterator[Subscriber]:
    """Hear the topic of the node, in the network of the calling thread, or that which ``prefix`` enters."""
    env = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    with subprocess.Popen(
        [*prefix, PYTHON, LISTENER, TOPIC],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=env,
    ) as process:
        assert process.stdin is not None
        subscriber = Subscriber()
        reading = threading.Thread(target=_read, args=(process, subscriber), daemon=True)
        reading.start()
        try:
            yield subscriber
        finally:
            process.stdin.close()
            reading.join()


def _read(process: "subprocess.Popen[str]", subscriber: Subscriber) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        message, _, heard = line.rpartition(" ")
        if message:
            subscriber.add([message], int(heard))
        else:
            subscriber.publishers = int(line)
