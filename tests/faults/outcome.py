"""What one run of edgectl did, and what it must do."""

import json
from dataclasses import dataclass

from tests.pace import patience

WORST_S = 120.0


class ExpectationError(AssertionError):
    """The product did not do what the fault calls for; the text says what it did instead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One run of edgectl."""

    words: tuple[str, ...]
    code: int
    out: str
    err: str
    seconds: float

    def __str__(self) -> str:
        return f"edgectl {' '.join(self.words)}: exit {self.code} in {self.seconds:.1f} s; stderr: {self.err.strip()[-500:]!r}, stdout: {self.out.strip()[-500:]!r}"

    def must(self, *codes: int, within: float = WORST_S) -> "Outcome":
        """This outcome, if its exit code is one of these and it came in time."""
        if self.code not in codes or self.seconds > patience(within):
            raise ExpectationError(
                f"wanted exit {' or '.join(map(str, codes))} within {within:.0f} s: {self}"
            )
        return self

    def says(self, *words: str) -> "Outcome":
        """This outcome, if all of these words stand in its output."""
        text = (self.out + self.err).lower()
        if missing := [word for word in words if word.lower() not in text]:
            raise ExpectationError(f"does not say {missing}: {self}")
        return self

    @property
    def data(self) -> dict[str, object]:
        """Its JSON."""
        return dict(json.loads(self.out))
