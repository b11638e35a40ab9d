# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of the YAML files: every shipped file is valid, and what the readers refuse by its form is not."""

import importlib
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from edgectl.cli.schema import EDITED_KINDS, build_schema, list_kinds
from tests.config import test_bad_inventories, test_bad_tasks
from tests.config.broken_files import INVENTORY, TASKS, BrokenFile

ROOT = Path(__file__).parents[2]
FILES = {
    "inventory": ["inventories/*.yaml", "tasks/patrol/fleet.yaml"],
    "tasks": ["tasks/*.yaml", "tasks/patrol/tasks.yaml", "tasks/patrol/ros2.yaml"],
    "project": ["edgectl/scaffold/edgectl.yaml"],
    "experiment": ["tasks/patrol/experiment.yaml"],
    "scenario": ["docs/scenarios/[!s]*.yaml"],  # all but sweep-*.yaml
    "sweep": ["docs/scenarios/sweep-*.yaml"],
}
# Types, missing and unknown keys, words, names, quantities, versions: all that concerns the form of a file.
# Beyond a schema: numbers that JSON has not, what defaults decide, the sum that a text means.
NOT_OF_FORM = ("capacity not a number", "huge capacity", "host missing", "demand above all")
CODES_OF_FORM = {"EC010", "EC011", "EC012", "EC013", "EC014", "EC015", "EC016", "EC019"}


def list_faults(kind: str, value: object) -> list[str]:
    return [error.message for error in Draft202012Validator(build_schema(kind)).iter_errors(value)]


def load(text: str) -> Any:
    """YAML 1.2 as edgectl reads it, where PyYAML knows 1.1: no yes and no, no base 60."""
    from edgectl.config.node import value_from_node
    from edgectl.config.problems import Problems
    from edgectl.config.source import decode_source
    from edgectl.config.yaml_parser import parse_yaml

    problems = Problems()
    source = decode_source("file", text.encode(), problems)
    node = parse_yaml(source, problems) if source is not None else None
    return value_from_node(node) if node is not None else None


@pytest.mark.parametrize("kind", list_kinds())
def test_each_schema_is_one(kind: str) -> None:
    Draft202012Validator.check_schema(build_schema(kind))


@pytest.mark.parametrize("kind", EDITED_KINDS)
def test_shipped_files_are_valid(kind: str) -> None:
    found = [path for pattern in FILES[kind] for path in ROOT.glob(pattern)]
    assert found
    for path in found:
        assert list_faults(kind, load(path.read_text())) == [], path


def test_the_good_files_of_the_corpus_are_valid() -> None:
    assert list_faults("inventory", load(INVENTORY)) == []
    assert list_faults("tasks", load(TASKS)) == []


def list_corpus() -> list[tuple[str, str, BrokenFile]]:
    corpus = []
    for module, kind, text in (
        (test_bad_inventories, "inventory", INVENTORY),
        (test_bad_tasks, "tasks", TASKS),
    ):
        found = [bad for value in vars(importlib.import_module(module.__name__)).values() if isinstance(value, list | tuple)
                 for bad in value if isinstance(bad, BrokenFile)]  # fmt: skip
        corpus += [
            (kind, text, bad) for bad in found if bad.code in CODES_OF_FORM and bad.name not in NOT_OF_FORM
        ]
    return corpus


@pytest.mark.parametrize(
    ("kind", "text", "bad"),
    list_corpus(),
    ids=lambda value: value.name if isinstance(value, BrokenFile) else "",
)
def test_what_the_readers_refuse_by_its_form_the_schema_refuses(
    kind: str, text: str, bad: BrokenFile
) -> None:
    assert bad.old in text
    assert list_faults(kind, load(text.replace(bad.old, bad.new, 1))), bad.name
