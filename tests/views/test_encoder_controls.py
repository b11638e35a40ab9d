# SPDX-License-Identifier: Apache-2.0
"""Characters that drive a terminal stand as escapes in every form, and the document stays the same."""

import json

import yaml

from edgectl.views.encoder import encode_csv, encode_json, encode_json_lines, encode_yaml

NASTY = "\x9b31m\u202egnp\x1b]0;owned\x07\u2028\ufeff\x7f caf\u00e9"
DOCUMENT = {"detail": NASTY}


def test_no_form_holds_a_character_that_drives_a_terminal() -> None:
    forms = [
        encode_json(DOCUMENT),
        encode_json_lines([DOCUMENT]),
        encode_yaml(DOCUMENT),
        encode_csv([DOCUMENT]),
    ]
    for text in forms:
        assert all(char.isprintable() or char == "\n" for char in text)
    assert json.loads(forms[0]) == json.loads(forms[1]) == yaml.safe_load(forms[2]) == DOCUMENT
    assert "caf\u00e9" in forms[0]


def test_half_a_surrogate_does_not_end_the_output() -> None:
    encode_json({"detail": "\ud800"}).encode()
