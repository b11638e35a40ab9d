# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of the documents that -o json prints: every view's document is valid, with no other keys."""

from functools import cache
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from edgectl.cli.schema import build_schema
from edgectl.views.document_keys import INNER_KEYS, ITEM_KEYS, LIST_KEYS
from edgectl.views.document_schema import DOCUMENT_KINDS, build_view_schema
from edgectl.views.glossary import list_keys
from edgectl.views.output import ItemView, ListView, View
from tests.views.test_glossary import VIEWS


def close(schema: Any) -> Any:
    """The same schema without room for unknown keys, which readers should ignore."""
    if isinstance(schema, list):
        return [close(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {key: close(value) for key, value in schema.items()}
    is_object = isinstance(schema.get("properties"), dict) and "type" in schema
    return {"additionalProperties": False, **closed} if is_object else closed


@cache
def build_validator(kind: str) -> Draft202012Validator:
    return Draft202012Validator(close(build_view_schema(kind)))


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: type(view).__name__)
def test_the_document_of_each_view_is_valid(view: View) -> None:
    document = view.document()
    faults = build_validator(str(document["kind"])).iter_errors(document)
    assert [f"{fault.json_path}: {fault.message}" for fault in faults] == []


def test_every_kind_has_a_view_of_its_form() -> None:
    assert {view.kind for view in VIEWS if isinstance(view, ListView)} == set(LIST_KEYS)
    assert {view.kind for view in VIEWS if isinstance(view, ItemView)} == set(ITEM_KEYS)


def test_every_key_of_the_tables_is_in_the_glossary() -> None:
    named = {key for table in (LIST_KEYS, ITEM_KEYS, INNER_KEYS) for keys in table.values() for key in keys}
    known = {entry.key for entry in list_keys()}
    assert (named | set(INNER_KEYS)) - known == set()
    assert known - named - {"format_version", "item", "items"} == set()


@pytest.mark.parametrize(
    ("kind", "document"),
    [
        ("version", {"format_version": 2, "kind": "version", "warnings": []}),
        ("version", {"format_version": 1, "kind": "version", "item": {}, "warnings": []}),
        ("event", {"format_version": 2, "kind": "event", "items": [{"id": "1"}], "warnings": []}),
        ("edge", {"format_version": 2, "kind": "edge", "item": {}, "items": [], "warnings": []}),
    ],
)
def test_other_documents_are_not_valid(kind: str, document: object) -> None:
    assert not Draft202012Validator(build_view_schema(kind)).is_valid(document)


def test_edgectl_schema_prints_them() -> None:
    assert {kind: build_schema(kind) for kind in DOCUMENT_KINDS if kind != "experiment"} == {
        kind: build_view_schema(kind) for kind in DOCUMENT_KINDS if kind != "experiment"
    }
    assert build_schema("experiment-results") == build_view_schema("experiment")
