# SPDX-License-Identifier: Apache-2.0
"""Error of a declined request."""


class RefusalError(Exception):
    """A declined request: stable ``kind``, one-line ``message`` and ``hint`` for the operator."""

    def __init__(self, kind: str, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.kind = kind
        self.message = message
        self.hint = hint
