# SPDX-License-Identifier: Apache-2.0
"""The process of the ROS gateway: a real child of this machine's python3, with a stand-in for the packages of ROS.

The stand-in replaces what lies behind the child: it writes down what would be published. make ros hears real topics.
"""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import EdgectlError, ExitCode, FileError, RosGraphError
from edgectl.export import ros_gateway
from edgectl.export.ros_gateway import RosNode, build_node_environment, run_ros_node
from edgectl.formats.document import Document
from edgectl.model.ros import RosSettings
from tests.e2e.test_unreachable import wait_until
from tests.ros1_peer import serve_master
from tests.rospy_standin import ROSPY, read_published, write_standin

DOCUMENT: Document = {
    "diagnostics": [
        {
            "name": "edgectl lab: task slam",
            "level": 1,
            "message": "unhealthy",
            "hardware_id": "edge1",
            "values": {"k": "v"},
        }
    ],
    "status": '{"items": []}',
}


@pytest.fixture
def ros(tmp_path: Path) -> RosSettings:
    """ROS 1 from a set-up file of this machine, without a master."""
    return RosSettings(version=1, setup=(str(write_standin(tmp_path)),), master="http://127.0.0.1:9")


def send_and_wait(node: RosNode) -> None:
    node.send(DOCUMENT)
    node.wait(60.0)


def test_what_is_sent_is_published_until_the_input_ends(tmp_path: Path, ros: RosSettings) -> None:
    with (
        serve_master() as master,
        run_ros_node("a-lab", replace(ros, master=master.uri), stale_s=60.0) as node,
    ):
        node.send(DOCUMENT)
        wait_until(lambda: len(read_published(tmp_path)) >= 2, 20.0)
    (first, array), second, *_, last = read_published(tmp_path)
    assert first == "/diagnostics"
    assert isinstance(array, dict)
    [status] = array["status"]
    assert (status["name"], status["level"], status["message"]) == ("edgectl lab: task slam", 1, "unhealthy")
    assert [(each["key"], each["value"]) for each in status["values"]] == [("k", "v")]
    assert second == ("/edgectl/status", DOCUMENT["status"])
    assert last == ("goodbye", "edgectl has ended")


def test_what_is_old_is_stale_and_the_document_is_not_repeated(tmp_path: Path, ros: RosSettings) -> None:
    with serve_master() as master, run_ros_node("lab", replace(ros, master=master.uri), stale_s=0.0) as node:
        node.send(DOCUMENT)
        wait_until(lambda: bool(read_published(tmp_path)), 20.0)
    (topic, array), *rest = read_published(tmp_path)
    assert topic == "/diagnostics"
    assert isinstance(array, dict)
    assert array["status"][0]["level"] == 3
    assert array["status"][0]["message"].startswith("edgectl has measured nothing for ")
    assert "/edgectl/status" not in dict(rest)


def test_each_failure_has_its_exit_code_and_remedy(
    tmp_path: Path, ros: RosSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_gateway, "_MASTER_S", 0.1)
    with (
        pytest.raises(
            RosGraphError, match=r"the ROS master at http://127\.0\.0\.1:9 has not answered"
        ) as found,
        run_ros_node("lab", ros, stale_s=9.0),
    ):
        pass
    assert found.value.exit_code is ExitCode.TRY_AGAIN
    (tmp_path / "ros" / "rospy.py").unlink()
    with (
        pytest.raises(EdgectlError, match="No module named 'rospy'") as missing,
        run_ros_node("lab", ros, stale_s=9.0),
    ):
        pass
    assert missing.value.exit_code is ExitCode.FAILED
    assert "--setup" in missing.value.hint
    with (
        pytest.raises(FileError, match=r"nothing\.bash"),
        run_ros_node("lab", ros, setup=[str(tmp_path / "nothing.bash")], stale_s=9.0),
    ):
        pass
    (tmp_path / "setup.bash").write_text("exit 7\n")
    with pytest.raises(EdgectlError, match="ended with exit code 7"), run_ros_node("lab", ros, stale_s=9.0):
        pass


def test_a_node_that_dies_is_an_error_at_once(tmp_path: Path, ros: RosSettings) -> None:
    (tmp_path / "ros" / "rospy.py").write_text(ROSPY + "\nPublisher.publish = lambda *_: os._exit(9)\n")
    with (
        pytest.raises(EdgectlError, match="ended with exit code 9"),
        serve_master() as master,
        run_ros_node("lab", replace(ros, master=master.uri), stale_s=60.0) as node,
    ):
        send_and_wait(node)


def test_an_address_that_the_shell_states_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    ros = RosSettings(version=1, master="http://10.0.0.1:11311")
    monkeypatch.delenv("ROS_IP", raising=False)
    monkeypatch.delenv("ROS_HOSTNAME", raising=False)
    assert build_node_environment(ros, ["127.0.0.1"])["ROS_IP"] == "127.0.0.1"
    assert "ROS_IP" not in build_node_environment(ros, ["no.such.name.invalid"])
    monkeypatch.setenv("ROS_HOSTNAME", "laptop")
    found = build_node_environment(ros, ["127.0.0.1"])
    assert ("ROS_IP" in found, found["ROS_MASTER_URI"]) == (False, "http://10.0.0.1:11311")
    assert build_node_environment(None, []) == dict(os.environ)
