# SPDX-License-Identifier: Apache-2.0
"""A value that must not be seen: it reads as ``***`` unless code asks for it by name."""

MASK = "***"


class Secret(str):
    """Text that is ``***`` for everything that prints, compares, hashes or encodes it.

    ``reveal`` gives the value. So a view, a digest, a plan or a traceback that nobody thought of shows the
    mask; only the request that starts a task reveals it.
    """

    __slots__ = ("_value",)
    _value: str

    def __new__(cls, value: str) -> "Secret":
        """Hide ``value``."""
        made = super().__new__(cls, MASK)
        made._value = value
        return made

    def reveal(self) -> str:
        """The value in clear: to be sent, and nowhere else."""
        return self._value
