# SPDX-License-Identifier: Apache-2.0
"""Node that publishes the state of a fleet: a program of its own, run by ``python3 -c`` of a ROS environment.

Its argument is a JSON object: ``report_fd``, ``name``, ``version`` (of ROS; null: the one that is found),
``topic``, ``master_s`` (how long a master may be silent) and ``stale_s``. Each line on standard input is one
too: ``diagnostics`` and ``status``. The last one is published once a second until it is ``stale_s`` old; from
then on the diagnostics are stale, and nothing is said on ``topic``. The end of the input is the end of the
node. On ``report_fd`` it says that it is ready, or why it cannot go on, as [kind, text].
"""

import importlib
import importlib.util
import json
import os
import sys
import threading
import time
import xmlrpc.client

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, NoReturn

_PERIOD_S, _CALL_S, _RETRY_S, _LOOK_S = 1.0, 3.0, 0.2, 2.0
_STALE = 3
_CALLER = "/edgectl"


class _Transport(xmlrpc.client.Transport):
    """Calls with a deadline."""

    def make_connection(self, host: "Any") -> "Any":
        made = super().make_connection(host)
        made.timeout = _CALL_S
        return made


class Ros1Node:
    """A node of rospy."""

    def __init__(self, asked: "dict[str, Any]") -> None:
        self.rospy: "Any" = importlib.import_module("rospy")
        self.kinds: "Any" = importlib.import_module("diagnostic_msgs.msg")
        text: "Any" = importlib.import_module("std_msgs.msg").String
        self.report_fd, self.master_s = asked["report_fd"], asked["master_s"]
        self.master = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        if not self.wait_for_master("lookupNode", "/rosout"):
            fail(self.report_fd, "no-master", self.master)
        # Others of this name go on: rospy adds a number of its own.
        self.rospy.init_node(asked["name"], anonymous=True, disable_signals=True, disable_rosout=True)
        self.diagnostics = self.rospy.Publisher("/diagnostics", self.kinds.DiagnosticArray, queue_size=1)
        self.status = self.rospy.Publisher(asked["topic"], text, queue_size=1)
        threading.Thread(target=self.watch_master, daemon=True).start()

    def wait_for_master(self, method: str, *words: str) -> "Any":
        """The answer of the master, as [code, text, value]; None where it is silent for ``master_s``."""
        until = time.monotonic() + self.master_s
        while time.monotonic() < until:
            try:
                proxy = xmlrpc.client.ServerProxy(self.master, transport=_Transport())
                return getattr(proxy, method)(_CALLER, *words)
            except Exception:  # whatever it is, this is no master that answers
                time.sleep(_RETRY_S)
        return None

    def watch_master(self) -> None:
        """End the node when its master is gone, or was restarted and does not know it."""
        while True:
            time.sleep(_LOOK_S)
            answer = self.wait_for_master("lookupNode", self.rospy.get_name())
            if self.rospy.is_shutdown():
                return
            if answer is None:
                fail(self.report_fd, "no-master", self.master)
            if answer[0] != 1:
                fail(self.report_fd, "forgotten", self.master)

    def publish(self, diagnostics: "list[dict[str, Any]]", status: "str | None") -> None:
        """Publish both now; without ``status`` the diagnostics alone."""
        array = self.kinds.DiagnosticArray(status=build_statuses(self.kinds, diagnostics, int))
        array.header.stamp = self.rospy.Time.now()
        self.diagnostics.publish(array)
        if status is not None:
            self.status.publish(status)

    def end(self) -> None:
        """Say goodbye to the master."""
        self.rospy.signal_shutdown("edgectl has ended")


class Ros2Node:
    """A node of rclpy."""

    def __init__(self, asked: "dict[str, Any]") -> None:
        self.rclpy: "Any" = importlib.import_module("rclpy")
        self.kinds: "Any" = importlib.import_module("diagnostic_msgs.msg")
        self.text: "Any" = importlib.import_module("std_msgs.msg").String
        self.rclpy.init(args=[])
        self.node = self.rclpy.create_node("%s_%d" % (asked["name"], os.getpid()), enable_rosout=False)
        self.diagnostics = self.node.create_publisher(self.kinds.DiagnosticArray, "/diagnostics", 10)
        self.status = self.node.create_publisher(self.text, asked["topic"], 10)

    def publish(self, diagnostics: "list[dict[str, Any]]", status: "str | None") -> None:
        """Publish both now; without ``status`` the diagnostics alone."""
        levels = build_statuses(self.kinds, diagnostics, lambda level: bytes([level]))
        array = self.kinds.DiagnosticArray(status=levels)
        array.header.stamp = self.node.get_clock().now().to_msg()
        self.diagnostics.publish(array)
        if status is not None:
            self.status.publish(self.text(data=status))

    def end(self) -> None:
        """Leave the graph."""
        self.node.destroy_node()
        self.rclpy.shutdown()


def build_statuses(kinds: "Any", diagnostics: "list[dict[str, Any]]", level_of: "Any") -> "list[Any]":
    """Build the messages DiagnosticStatus."""
    return [
        kinds.DiagnosticStatus(
            level=level_of(each["level"]),
            name=each["name"],
            message=each["message"],
            hardware_id=each["hardware_id"],
            values=[kinds.KeyValue(key=key, value=value) for key, value in each["values"].items()],
        )
        for each in diagnostics
    ]


class Input:
    """The last line on standard input, read beside the node."""

    def __init__(self) -> None:
        self.last: "tuple[float, dict[str, Any]] | None" = None
        self.ended = threading.Event()
        threading.Thread(target=self.read, daemon=True).start()

    def read(self) -> None:
        """Read until the end."""
        try:
            for line in sys.stdin.buffer:
                self.last = time.monotonic(), json.loads(line.decode("utf-8"))
        finally:
            self.ended.set()


def publish_input(node: "Any", stale_s: float) -> None:
    """Publish the last line once a second until the input ends."""
    source, due = Input(), time.monotonic()
    while not source.ended.wait(max(0.0, due - time.monotonic())):
        if source.last is not None:
            taken_at, content = source.last
            age_s = time.monotonic() - taken_at
            if age_s < stale_s:
                node.publish(content["diagnostics"], content["status"])
            else:
                node.publish([dict(each, **describe_silence(age_s)) for each in content["diagnostics"]], None)
        due = max(due + _PERIOD_S, time.monotonic())


def describe_silence(age_s: float) -> "dict[str, Any]":
    """Fields of everything that was last measured so long ago."""
    return {"level": _STALE, "message": "edgectl has measured nothing for %d s" % age_s}


def choose_version(stated: "int | None") -> int:
    """The version stated, else that of the set-up files, else what is installed. Raises ImportError."""
    known = stated or os.environ.get("ROS_VERSION")
    if known:
        return int(known)
    for version, name in ((1, "rospy"), (2, "rclpy")):
        if importlib.util.find_spec(name) is not None:
            return version
    raise ImportError("neither rospy nor rclpy")


def report(fd: int, kind: str, text: str) -> None:
    """Tell edgectl."""
    os.write(fd, json.dumps([kind, text]).encode("utf-8") + b"\n")


def fail(fd: int, kind: str, text: str) -> "NoReturn":
    """Tell edgectl, and end at once."""
    report(fd, kind, text)
    os._exit(1)


def main(asked: "dict[str, Any]") -> None:
    """Publish until the input ends."""
    # The empty entry is the working directory, whose files have nothing to do with this program.
    sys.path[:] = [entry for entry in sys.path if entry]
    try:
        node: "Any" = Ros1Node(asked) if choose_version(asked["version"]) == 1 else Ros2Node(asked)
        report(asked["report_fd"], "ready", "")
        publish_input(node, asked["stale_s"])
        node.end()
    except ImportError as error:
        fail(asked["report_fd"], "no-ros", "%s: %s" % (sys.executable, error))
    except Exception as error:  # what edgectl cannot name, it passes on
        fail(asked["report_fd"], "failed", "%s: %s" % (type(error).__name__, error))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
