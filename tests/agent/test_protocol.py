# SPDX-License-Identifier: Apache-2.0
"""The protocol between manager and agent: name rules in both forms, states, operations, keys."""

import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.agent.link import document_keys, main, protocol
from edgectl.agent.link.errors import RefusalError
from edgectl.executor import host_requests as requests
from edgectl.gateway.probe_request import build_probe_request
from edgectl.model.check import Check
from edgectl.model.snapshot import TaskState
from edgectl.model.standby import Activation, StandbyRule, StateRule
from tests.agent.conftest import AgentHost
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks

STATE = StateRule(save=Check(command="true"), load=Check(command="true"))
OPERATIONS = sorted(value for name, value in vars(protocol).items() if name.startswith("OP_"))
NAMES = st.text("aZ09_.:/-\0\n \u00e9", max_size=5) | st.integers(60, 66).map(lambda length: "a" * length)


@given(NAMES)
def test_pattern_and_predicate_of_a_name_agree(text: str) -> None:
    assert protocol.is_name(text) == (re.fullmatch(protocol.NAME_PATTERN, text) is not None)


@given(NAMES)
def test_pattern_and_predicate_of_a_metric_agree(text: str) -> None:
    assert protocol.is_metric_name(text) == (re.fullmatch(protocol.METRIC_NAME_PATTERN, text) is not None)


@pytest.mark.parametrize("value", [None, 1, b"slam", ["slam"]])
def test_only_a_string_is_a_name(value: object) -> None:
    assert not protocol.is_name(value)


def test_every_reported_state_is_one_of_the_model() -> None:
    assert {*protocol.ALIVE_STATES, *protocol.FINAL_STATES} - {protocol.STOPPED} == set(TaskState)
    assert {state for state in TaskState if state.alive} == set(protocol.ALIVE_STATES)


@pytest.mark.parametrize(
    "operation", sorted({*OPERATIONS} - {protocol.OP_CONVERSE, protocol.OP_FOLLOW, protocol.OP_READ_STATE})
)
def test_every_operation_is_found(operation: str) -> None:
    assert callable(main._find_operation(operation))


def test_an_unknown_operation_is_refused() -> None:
    with pytest.raises(RefusalError, match="no operation 'dance'"):
        main._find_operation("dance")


def test_requests_of_the_manager_have_the_stated_keys() -> None:
    edge, task = an_edge("edge1"), a_task("slam", done_when=Check(command="true"))
    fleet = an_inventory(edge, a_robot("robot1"))
    sent = [
        requests.build_start_request(task, edge, fleet.hosts),
        requests.build_stop_request("slam", edge, task=task, instance="i"),
        requests.build_wait_request("slam", edge, instance="i", timeout_s=1.0),
        requests.build_mark_ready_request("slam", edge, instance="i"),
        requests.build_leaving_request("slam", edge, instance="i", seconds=1.0),
        requests.build_check_request(task, Check(command="true"), edge, fleet.hosts),
        requests.build_status_request(edge),
        requests.build_activate_request(task, edge, fleet.hosts, instance="i", await_go_s=5.0),
        requests.build_deactivate_request(task, edge, fleet.hosts, instance="i"),
        build_probe_request(
            edge, fleet, some_tasks(task), {"robot1": "127.0.0.1"}, window_s=0.5, timeout_s=10.0
        ),
    ]
    for request in sent:
        assert set(request) == {"op", "fleet", "host", *document_keys.REQUEST_KEYS[str(request["op"])]}
    spec = sent[0]["spec"]
    assert isinstance(spec, dict)
    assert set(spec) == set(document_keys.SPEC_KEYS)
    rule = StandbyRule(activation=Activation(activate=Check(command="a"), deactivate=Check(command="d")))
    sent_rule = requests.build_start_request(replace(task, standby=rule), edge, fleet.hosts, role="standby")
    spec = sent_rule["spec"]
    assert isinstance(spec, dict)
    assert set(spec["activation"]) == set(document_keys.ACTIVATION_KEYS)
    assert (sent_rule["role"], sent[0]["role"]) == ("standby", "active")


def test_replies_of_the_agent_have_the_stated_keys(host: AgentHost) -> None:
    host.start("slam", 'echo "fps 1" >>"$EDGECTL_METRICS"; exec sleep 600')
    host.start("work", "exit 3")
    host.until("work", "failed")
    reply = host.ask("probe", window_s=0.05, detect=[{"task": "none", "cmdline": "no-such-thing"}])
    of_hardware = {"gpu", "gpu_memory", "power", "battery"} - set(reply)
    assert set(reply) == set(document_keys.PROBE_KEYS) - {"resident", "sample_age_s", "lease"} - of_hardware
    host.ask("profiler-start", every_s=0.2, ttl_s=600.0)
    try:
        assert set(host.ask("probe", window_s=0.05)) <= set(document_keys.PROBE_KEYS)
    finally:
        host.ask("profiler-stop")
    host.stop("slam")
    assert set().union(*reply["tasks"].values()) == set(document_keys.ENTRY_KEYS) - (
        {"metrics", "orphaned", "adoptable", "engine", "container"} - set(reply["tasks"]["slam"])
    )
