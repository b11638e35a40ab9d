# SPDX-License-Identifier: Apache-2.0
"""explain of keys, codes and checks: all of them, as the pages describe them."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.cli.main import main
from edgectl.config.inventory_file import build_inventory_schema
from edgectl.config.key_reference import find_reference, is_reference_word, list_reference_words
from edgectl.config.problems import ProblemCode
from edgectl.config.task_file import build_tasks_schema
from edgectl.errors import UsageError
from tests.docs.key_reference import TARGET, build_key_reference

WORDS = set(list_reference_words())


def test_the_reference_is_that_of_the_pages() -> None:
    assert TARGET.read_text() == build_key_reference(), "python -m tests.docs.key_reference"


def list_keys(schema: dict[str, Any], path: str) -> Iterator[str]:
    for form in [schema, *schema.get("anyOf", [])]:
        for key, inner in form.get("properties", {}).items():
            yield f"{path}.{key}"
            yield from list_keys(inner, f"{path}.{key}")


def test_every_key_of_an_inventory_and_a_task_file_is_described() -> None:
    """Two levels; a check is described once, as that of ready."""
    inventory, tasks = build_inventory_schema()["properties"], build_tasks_schema()["properties"]
    keys = [
        *(f"inventory.{key}" for key in inventory),
        *(f"tasks.{key}" for key in tasks),
        *list_keys(inventory["edges"]["additionalProperties"], "host"),
        *list_keys(inventory["robots"]["additionalProperties"], "host"),
        *list_keys(inventory["links"]["items"], "link"),
        *list_keys(tasks["tasks"]["additionalProperties"], "task"),
    ]
    missing = {key for key in keys if key.count(".") < 3 and not key.startswith("task.done_when.")} - WORDS
    assert missing == set()


def test_every_code_is_described() -> None:
    assert {code.value for code in ProblemCode} == {word for word in WORDS if word.startswith("EC")}


def test_codes_and_roots_in_any_form_and_the_keys_below() -> None:
    assert find_reference("ec101") == find_reference("EC101")
    for word in ("edge.limits", "robots.limits", "hosts.limits"):
        assert [key.name for key in find_reference(word).keys] == [
            "host.limits.cpu", "host.limits.memory", "host.limits.gpu", "host.limits.gpu_memory", "host.limits.power",
            "host.limits.battery",
        ]  # fmt: skip
    words = ("slam-robot1", "task", "EC1", "v1.2", "task.up", "check.clock")
    assert [is_reference_word(word) for word in words] == [False, False, False, False, True, True]
    with pytest.raises(UsageError) as refused:
        find_reference("edge.limts")
    assert refused.value.hint == "did you mean host.limits?"


def test_no_file_is_read(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["explain", "task.demand.cpu"]) == 0
    assert capsys.readouterr().out.splitlines()[:2] == ["task.demand.cpu", "CPU demand"]
    assert main(["explain", "EC018", "-o", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["item"]["meaning"].startswith("plaintext password")
    assert main(["explain", "task.demand.cpv"]) == 64
