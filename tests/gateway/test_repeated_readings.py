# SPDX-License-Identifier: Apache-2.0
"""What a host repeats, in a reply or in an update, is the very same; what it says anew is what is decoded."""

import copy
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from edgectl.gateway.readings import FleetReadings
from edgectl.transport.readings import ReadingFeeds

Document = dict[str, Any]
KEYS = st.sampled_from(["cpu", "links", "tasks", "totals"])
ENTRIES = st.dictionaries(st.sampled_from(["robot1", "robot2", "a"]), st.integers(0, 2) | st.none())
DOCUMENTS = st.dictionaries(KEYS, ENTRIES | st.lists(st.integers(0, 1)) | st.integers(0, 2) | st.none())


@given(st.lists(st.tuples(st.booleans(), DOCUMENTS, st.sets(KEYS)), min_size=1, max_size=8))
def test_equal_parts_are_the_same_and_the_whole_is_what_was_said(
    steps: list[tuple[bool, Document, set[str]]],
) -> None:
    readings = FleetReadings[Document](ReadingFeeds(), every=1.0)
    said: Document = {}
    kept: Document | None = None

    def decode(document: Document, known: tuple[Any, Document] | None) -> Document:
        assert known is None or (known[0] is kept and known[1] is kept)
        return document

    for is_update, document, gone in steps:
        # An update leaves what it does not name as the object that it was.
        said = {**said, **document} if is_update else {**copy.deepcopy(said), **document}
        said = {key: value for key, value in said.items() if key not in gone}
        found = readings.decode("edge1", said, decode)
        assert found == said
        assert list(found) == list(said)
        for key, value in found.items():
            was = None if kept is None else kept.get(key)
            assert value is was or value != was or kept is None
            if isinstance(value, dict) and isinstance(was, dict):
                assert all(each is was[name] for name, each in value.items() if was.get(name, ...) == each)
        assert readings.decode("edge1", said, decode) is found
        kept = found
