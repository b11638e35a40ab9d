# SPDX-License-Identifier: Apache-2.0
"""encode then decode gives the same value, and the same bytes again."""

import json
from contextlib import suppress

from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.formats.document import FormatErrors, dump_document
from edgectl.formats.kinds import MANAGER_STATE_KIND, PLAN_KIND, SNAPSHOT_KIND
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.snapshot import Snapshot
from tests.formats.strategies import memories, plans, snapshots

bounded = settings(max_examples=settings().max_examples * 2 // 5)


@bounded
@given(snapshots)
def test_snapshot_survives(value: Snapshot) -> None:
    text = dump_document(SNAPSHOT_KIND.encode(value))
    back = SNAPSHOT_KIND.decode(json.loads(text))
    assert back == value
    assert dump_document(SNAPSHOT_KIND.encode(back)) == text


@bounded
@given(memories)
def test_memory_survives(value: ManagerState) -> None:
    text = dump_document(MANAGER_STATE_KIND.encode(value))
    assert MANAGER_STATE_KIND.decode(json.loads(text)) == value


@bounded
@given(plans)
def test_plan_survives(value: Plan) -> None:
    text = dump_document(PLAN_KIND.encode(value))
    back = PLAN_KIND.decode(json.loads(text))
    assert back == value
    assert dump_document(PLAN_KIND.encode(back)) == text


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@bounded
@given(json_values)
def test_any_json_value_is_read_or_refused(value: object) -> None:
    for room in (SNAPSHOT_KIND, MANAGER_STATE_KIND, PLAN_KIND):
        with suppress(FormatErrors):
            room.decode(value)


@bounded
@given(plans, st.data())
def test_a_damaged_plan_is_read_or_refused(value: Plan, data: st.DataObject) -> None:
    document = json.loads(dump_document(PLAN_KIND.encode(value)))
    target = document
    while isinstance(target, dict | list) and target and data.draw(st.integers(0, 3)):
        keys = list(target) if isinstance(target, dict) else range(len(target))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(target[key], dict | list) or data.draw(st.booleans()):
            target[key] = data.draw(json_values)
            break
        target = target[key]
    with suppress(FormatErrors):
        PLAN_KIND.decode(document)
