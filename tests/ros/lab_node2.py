# SPDX-License-Identifier: Apache-2.0
"""A node of rclpy for launch files: it subscribes to fixed names and declares what parameters it is given.

``lab_node2.py ask SECONDS NODE..`` prints what the graph and the nodes' own parameter services say of nodes:
``{NODE: [[TOPIC, ..], {PARAMETER: VALUE}]}``, once all are there.
"""

import contextlib
import json
import os
import sys
import time
from typing import Any

import rclpy  # type: ignore[import-not-found]
from rcl_interfaces.srv import GetParameters, ListParameters  # type: ignore[import-not-found]
from rclpy.node import NodeNameNonExistentError  # type: ignore[import-not-found]
from rclpy.parameter import parameter_value_to_python  # type: ignore[import-not-found]
from std_msgs.msg import String  # type: ignore[import-not-found]


def be_node() -> None:
    """Serve until interrupted."""
    rclpy.init(args=sys.argv)
    node = rclpy.create_node(
        os.path.basename(sys.argv[0]),  # noqa: PTH119
        allow_undeclared_parameters=True,
        automatically_declare_parameters_from_overrides=True,
    )
    for name in os.environ["LAB_NAMES"].split():
        node.create_subscription(String, name, lambda _: None, 1)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def call(node: Any, kind: Any, name: str, deadline: float, **fields: object) -> Any:
    """The answer of a service."""
    client = node.create_client(kind, name)
    assert client.wait_for_service(timeout_sec=deadline - time.monotonic()), f"{name} is not offered"
    future = client.call_async(kind.Request(**fields))
    rclpy.spin_until_future_complete(node, future, timeout_sec=deadline - time.monotonic())
    assert future.done(), f"{name} does not answer"
    return future.result()


def wait_for_topics(node: Any, short: str, namespace: str, deadline: float) -> "list[str]":
    """To what a node subscribes, once two looks see the same; its services may be seen before itself."""
    before: list[str] = []
    while time.monotonic() < deadline:
        heard = []
        with contextlib.suppress(NodeNameNonExistentError):
            heard = node.get_subscriber_names_and_types_by_node(short, namespace)
        topics = sorted({topic for topic, _ in heard})
        if topics and topics == before:
            break
        before = topics
        time.sleep(0.3)
    return before


def ask(seconds: float, names: "list[str]") -> None:
    """Print what is known of each node."""
    deadline = time.monotonic() + seconds
    rclpy.init(args=[])
    node = rclpy.create_node("asking")
    found = {}
    for name in names:
        namespace, _, short = name.rpartition("/")
        listed = call(node, ListParameters, f"{name}/list_parameters", deadline).result.names
        values = call(node, GetParameters, f"{name}/get_parameters", deadline, names=listed).values
        topics = wait_for_topics(node, short, namespace or "/", deadline)
        read = [parameter_value_to_python(value) for value in values]
        plain = [value.tolist() if hasattr(value, "tolist") else value for value in read]
        found[name] = topics, dict(zip(listed, plain, strict=True))
    print(json.dumps(found))


if __name__ == "__main__":
    if sys.argv[1:2] == ["ask"]:
        ask(float(sys.argv[2]), sys.argv[3:])
    else:
        be_node()
