# SPDX-License-Identifier: Apache-2.0
"""Result of one edgectl command, with expectations."""

import json
from dataclasses import dataclass

from tests.pace import patience

WORST_S = 120.0


class ExpectationError(AssertionError):
    """edgectl did not behave as the fault requires; the text says what it did instead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandResult:
    """One run of edgectl."""

    words: tuple[str, ...]
    code: int
    out: str
    err: str
    seconds: float

    def __str__(self) -> str:
        return f"edgectl {' '.join(self.words)}: exit {self.code} in {self.seconds:.1f} s; stderr: {self.err.strip()[-500:]!r}, stdout: {self.out.strip()[-500:]!r}"

    def expect_exit(self, *codes: int, within: float = WORST_S) -> "CommandResult":
        """Return this result if it has one of these exit codes and finished in time."""
        if self.code not in codes or self.seconds > patience(within):
            raise ExpectationError(
                f"wanted exit {' or '.join(map(str, codes))} within {within:.0f} s: {self}"
            )
        return self

    def expect_output(self, *words: str) -> "CommandResult":
        """Return this result if its output contains all of these words."""
        text = (self.out + self.err).lower()
        if missing := [word for word in words if word.lower() not in text]:
            raise ExpectationError(f"does not say {missing}: {self}")
        return self

    @property
    def data(self) -> dict[str, object]:
        """Parse stdout as JSON."""
        return dict(json.loads(self.out))
