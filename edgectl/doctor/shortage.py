# SPDX-License-Identifier: Apache-2.0
"""Check of what all edges together lack for the tasks of the files."""

from collections.abc import Sequence

from edgectl.model.assignment import Shortage
from edgectl.model.diagnosis import Finding, Severity


def diagnose_shortages(shortages: Sequence[Shortage]) -> list[Finding]:
    """One finding for each resource that is short; one that all is well where none is."""
    if not shortages:
        message = "the edges together lack nothing of what the tasks need"
        return [Finding(host=None, check="room", level=Severity.OK, message=message)]
    return [
        Finding(
            host=None,
            check="room",
            level=Severity.WARNING,
            message=shortage.describe(),
            remedy="add an edge, or see which tasks use or demand most: edgectl plan -o wide",
        )
        for shortage in shortages
    ]
