# SPDX-License-Identifier: Apache-2.0
"""Code-quality report of a GitLab job: a JSON list with one entry per problem."""

import hashlib
from collections.abc import Iterable

from edgectl.errors import Problem
from edgectl.formats.document import Document
from edgectl.views.encoder import encode_json


def render_report(problems: Iterable[Problem]) -> str:
    """The report; empty: ``[]``, which GitLab reads as "no problems"."""
    return encode_json([_build_entry(problem) for problem in problems])


def _build_entry(problem: Problem) -> Document:
    text = problem.message + (f" (hint: {problem.hint})" if problem.hint else "")
    # GitLab compares reports by fingerprint: the place counts by its text, so that a line added above is no
    # new problem.
    seen = "\0".join((problem.file, problem.code, problem.message, problem.source.strip()))
    return {
        "description": text,
        "check_name": problem.code,
        "fingerprint": hashlib.sha256(seen.encode()).hexdigest(),
        "severity": "minor" if problem.warning else "major",
        "location": {"path": problem.file, "lines": {"begin": max(1, problem.line)}},
    }
