# SPDX-License-Identifier: Apache-2.0
"""secrets are revealed in the request that starts a task, and in no other."""

import json
import sys
from pathlib import Path

import pytest

from edgectl.errors import HostError
from edgectl.executor import host_requests
from edgectl.executor.secrets import resolve_environment, run_env_command
from edgectl.gateway.probe_request import build_probe_request
from edgectl.model.check import Check
from edgectl.model.secret import Secret
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks

CANARY = "canary-4711"


def command(text: str) -> tuple[str, ...]:
    return (sys.executable, "-c", text)


def test_the_later_wins_and_everything_is_in_clear() -> None:
    host = an_edge(
        env={"A": "host", "B": "host", "C": Secret("host")},
        env_command=command("print('B=hc'); print('C=hc'); print('D=hc')"),
    )
    task = a_task(env={"C": Secret("task"), "D": "task"}, env_command=command("print('D=tc')"))
    found = resolve_environment(task, host, {host.name: host})
    assert {name: found[name] for name in "ABCD"} == {"A": "host", "B": "hc", "C": "task", "D": "tc"}
    assert found["EDGECTL_TASK"] == "slam"


def test_only_a_start_that_is_sent_carries_secrets() -> None:
    check = Check(command="true")
    inventory = an_inventory(an_edge(env={"KEY": Secret(CANARY)}), a_robot())
    host = inventory.hosts["edge1"]
    task = a_task(env={"TOKEN": Secret(CANARY), "PLAIN": "x"}, done_when=check)
    looked_at = host_requests.build_start_request(task, host, inventory.hosts)
    variables = resolve_environment(task, host, inventory.hosts)
    sent = host_requests.fill_start_request(
        looked_at, instance="i", generation=1, manager="", variables=variables
    )
    assert json.dumps(sent).count(CANARY) == 2
    assert looked_at["spec"]["env"]["TOKEN"] == "***"  # type: ignore[index]
    asked = host_requests.build_check_request(task, check, host, inventory.hosts)
    assert "TOKEN" not in asked["env"]  # type: ignore[operator]
    assert asked["env"]["PLAIN"] == "x"  # type: ignore[index]
    probed = build_probe_request(host, inventory, some_tasks(task), {}, window_s=0.1, timeout_s=5.0)
    assert CANARY not in json.dumps([looked_at, asked, probed])


def test_lines_are_read_as_they_are_written() -> None:
    text = "print('# a comment\\n\\nA=1\\r\\nB=x=y $(z) \\\\n\\n_C2=')"
    assert run_env_command(command(text), "task t") == {"A": "1", "B": "x=y $(z) \\n", "_C2": ""}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (f"print('A={CANARY}'); raise SystemExit(3)", "failed with exit code 3"),
        (f"print('A=1'); print('{CANARY}')", "printed a line 2 that is not NAME=value"),
        (f"print('A-B={CANARY}')", "printed a line 1 that is not NAME=value"),
        (f"print('A={CANARY}\\0')", "printed a line 1 that is not NAME=value"),
        (
            f"import sys; sys.stdout.buffer.write(b'A={CANARY}\\xff')",
            "printed a line 1 that is not NAME=value",
        ),
        (f"import time; print('A={CANARY}', flush=True); time.sleep(60)", "did not end within 0.5 s"),
    ],
)
def test_a_command_that_fails_says_why_and_nothing_that_it_printed(
    text: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edgectl.executor.secrets.ENV_COMMAND_TIMEOUT_S", 0.5 if "sleep" in text else 10.0)
    with pytest.raises(HostError) as raised:
        run_env_command(command(text), "task t")
    assert raised.value.message == f"env_command of task t {why}"
    assert raised.value.__suppress_context__ or raised.value.__context__ is None
    assert "canary" not in raised.value.hint


def test_a_command_that_is_not_there() -> None:
    with pytest.raises(HostError, match="env_command of task t cannot be run: No such file or directory"):
        run_env_command(("/nowhere/vault",), "task t")


def test_no_shell_reads_the_command(tmp_path: Path) -> None:
    made = tmp_path / "made"
    run_env_command(("echo", f"A=$(touch {made})"), "task t")
    assert not made.exists()
