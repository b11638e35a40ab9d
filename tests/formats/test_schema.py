# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of documents: what is written is valid, and what the codec refuses by its form is not."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from jsonschema import Draft202012Validator

from edgectl.experiments.files.run_codec import RUN_KIND, TRIAL_KIND
from edgectl.experiments.files.sweep_results import WORLD_KIND
from edgectl.formats.document import FormatErrors
from edgectl.formats.kinds import MANAGER_STATE_KIND, PLAN_KIND, SNAPSHOT_KIND, DocumentKind
from edgectl.model.snapshot import Snapshot
from tests.config.test_bad_documents import CASES, TEXTS
from tests.experiments.test_run_codec import RUN, TRIAL
from tests.experiments.test_sweep_command import RESULT as WORLD_RESULT
from tests.formats.strategies import snapshots
from tests.formats.test_complete import MANAGER, PLAN, SNAPSHOT
from tests.formats.test_round_trip import bounded

DOCS = Path(__file__).parents[2] / "docs"
VALIDATORS = {
    kind.name: Draft202012Validator(kind.schema())
    for kind in (SNAPSHOT_KIND, PLAN_KIND, MANAGER_STATE_KIND, RUN_KIND, TRIAL_KIND, WORLD_KIND)
}


def list_faults(kind: DocumentKind[Any], document: object) -> list[str]:
    return [f"{error.json_path}: {error.message}" for error in VALIDATORS[kind.name].iter_errors(document)]


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (SNAPSHOT_KIND, SNAPSHOT),
        (PLAN_KIND, PLAN),
        (MANAGER_STATE_KIND, MANAGER),
        (RUN_KIND, RUN),
        (TRIAL_KIND, TRIAL),
        (WORLD_KIND, WORLD_RESULT),
    ],
    ids=lambda value: value.name if isinstance(value, DocumentKind) else "",
)
def test_a_document_with_every_field_is_valid(kind: DocumentKind[Any], value: object) -> None:
    assert list_faults(kind, kind.encode(value)) == []


@bounded
@given(snapshots)
def test_any_snapshot_is_valid(value: Snapshot) -> None:
    assert list_faults(SNAPSHOT_KIND, SNAPSHOT_KIND.encode(value)) == []


@pytest.mark.parametrize(
    ("pattern", "kind"),
    [
        ("examples/snapshot.json", SNAPSHOT_KIND),
        ("e*/**/run.json", RUN_KIND),
        ("e*/**/trials/*.json", TRIAL_KIND),
    ],
)
def test_examples_are_valid(pattern: str, kind: DocumentKind[Any]) -> None:
    found = list(DOCS.glob(pattern))
    assert found
    for path in found:
        assert list_faults(kind, json.loads(path.read_text())) == [], path


# A schema says nothing of the text of a number or an instant, nor of JSON that is broken.
BEYOND_A_SCHEMA = ("infinite", "integer beyond floats", "instant", "no such month", "before year 1")
STRUCTURE = [name for name, case in CASES.items() if case[4] == "EC202" and name not in BEYOND_A_SCHEMA]


@pytest.mark.parametrize("name", STRUCTURE)
def test_what_the_codec_refuses_the_schema_refuses(name: str) -> None:
    what, old, new, *_ = CASES[name]
    kind = SNAPSHOT_KIND if what == "snapshot" else PLAN_KIND
    document = json.loads(TEXTS[what].replace(old, new, 1))
    with pytest.raises(FormatErrors):
        kind.decode(document)
    assert list_faults(kind, document)
