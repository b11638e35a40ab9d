"""The small JSON of the agent against the standard library's."""

import json
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.agent import light

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(VALUES)
def test_writes_and_reads_as_json_does(value: object) -> None:
    assert light.dumps(value) == json.dumps(value)
    assert light.loads(json.dumps(value)) == value


@pytest.mark.parametrize("text", ["", " ", "{", "[1,]", '{"a": 1} 2', "nul", "'a'", '"\n"'])
def test_refuses_what_is_not_json(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - the words are the interpreter's
        light.loads(text)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), object(), {1}, b"bytes"])
def test_refuses_what_json_has_no_form_for(value: object) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - the words are the interpreter's
        light.dumps([value])


def test_a_probe_starts_without_the_slow_modules(pytestconfig: pytest.Config) -> None:
    program = "import sys; import edgectl.agent.main, edgectl.agent.probe; print(sorted({'re', 'enum', 'json', 'socket', 'subprocess'} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, '.'); {program}"],
        capture_output=True,
        text=True,
        check=True,
        cwd=pytestconfig.rootpath,
    )
    assert done.stdout == "[]\n"
