# SPDX-License-Identifier: Apache-2.0
"""Text of hosts: bounded and printable, so that no host can drive a terminal or fill a file. Pure."""

import unicodedata

MAX_TEXT = 4096
_ESCAPED_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")


def escape_unprintable(text: str) -> str:
    """``text`` with control and direction-changing characters and halves of surrogate pairs as escapes."""
    if text.isprintable() and text.isascii():
        return text
    return "".join(
        _escape_char(char) if unicodedata.category(char) in _ESCAPED_CATEGORIES else char for char in text
    )


def clean_text(value: object, limit: int = MAX_TEXT) -> str:
    """A value of a reply as printable text of at most ``limit`` characters before escapes; empty for None."""
    return "" if value is None else escape_unprintable(str(value)[:limit])


def _escape_char(char: str) -> str:
    return char.encode("unicode_escape", "surrogatepass").decode("ascii")
