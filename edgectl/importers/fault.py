# SPDX-License-Identifier: Apache-2.0
"""Fault at one place of an imported file, raised where an element cannot be read further."""

from collections.abc import Iterator
from contextlib import contextmanager

from edgectl.config.problems import Mark, ProblemCode, Problems


class ImportFaultError(Exception):
    """One mistake of an imported file. The reader collects it and goes on with the next element."""

    def __init__(self, mark: Mark, code: ProblemCode, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.mark, self.code, self.message, self.hint = mark, code, message, hint


@contextmanager
def collect_fault(problems: Problems) -> Iterator[None]:
    """Collect the fault of one element, so that reading goes on after it."""
    try:
        yield
    except ImportFaultError as fault:
        problems.add(fault.mark, fault.code, fault.message, fault.hint)
