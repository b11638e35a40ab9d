# SPDX-License-Identifier: Apache-2.0
"""A stand-in for the packages of ROS 1 behind a child process: what it would publish it writes down."""

import json
import sys
from pathlib import Path

MESSAGES = """
class Message:
    def __init__(self, **fields):
        self.__dict__.update(fields)
        self.header = type("Header", (), {})()
DiagnosticArray = DiagnosticStatus = KeyValue = String = Message
"""
ROSPY = """
import json, os
def init_node(name, **options): os.environ["NODE"] = name
def get_name(): return os.environ["NODE"]
def is_shutdown(): return True
class Time:
    @staticmethod
    def now(): return 0
def plain(value):
    return {"header": 0, **vars(value)} if hasattr(value, "header") else str(value)
class Publisher:
    def __init__(self, topic, kind, queue_size): self.topic = topic
    def publish(self, message):
        with open(os.environ["PUBLISHED"], "a") as file:
            file.write(json.dumps([self.topic, message], default=plain) + "\\n")
def signal_shutdown(reason):
    Publisher("goodbye", None, 1).publish(reason)
"""


def write_standin(folder: Path) -> Path:
    """Write the packages, and the set-up file by which python3 finds them."""
    for name, text in (
        ("rospy.py", ROSPY),
        ("diagnostic_msgs/msg.py", MESSAGES),
        ("std_msgs/msg.py", MESSAGES),
    ):
        (folder / "ros" / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / "ros" / name).write_text(text)
    setup = folder / "setup.bash"
    setup.write_text(
        f"export PATH={Path(sys.executable).parent}:$PATH PYTHONPATH={folder}/ros PUBLISHED={folder}/published\n"
        'echo "sourced with $# arguments"\n'
    )
    return setup


def read_published(folder: Path) -> list[tuple[str, object]]:
    """The messages so far, each with its topic; the last is the goodbye."""
    path = folder / "published"
    whole = path.read_text().splitlines(keepends=True) if path.exists() else []
    return [tuple(json.loads(line)) for line in whole if line.endswith("\n")]
