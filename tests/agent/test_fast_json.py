# SPDX-License-Identifier: Apache-2.0
"""The agent's JSON codec against the standard library's."""

import json
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.agent.link import fast_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(VALUES)
def test_encodes_and_decodes_as_json_does(value: object) -> None:
    assert fast_json.dumps(value) == json.dumps(value)
    assert fast_json.loads(json.dumps(value)) == value


@pytest.mark.parametrize("text", ["", " ", "{", "[1,]", '{"a": 1} 2', "nul", "'a'", '"\n"'])
def test_rejects_text_that_is_not_json(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - the message is the interpreter's
        fast_json.loads(text)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), object(), {1}, b"bytes"])
def test_rejects_values_without_a_json_form(value: object) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - the message is the interpreter's
        fast_json.dumps([value])


def test_a_probe_starts_without_the_slow_modules(pytestconfig: pytest.Config) -> None:
    program = "import sys; import edgectl.agent.link.main, edgectl.agent.measure.probe; print(sorted({'re', 'enum', 'json', 'socket', 'subprocess'} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, '.'); {program}"],
        capture_output=True,
        text=True,
        check=True,
        cwd=pytestconfig.rootpath,
    )
    assert done.stdout == "[]\n"
