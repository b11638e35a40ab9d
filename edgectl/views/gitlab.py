# SPDX-License-Identifier: Apache-2.0
"""Reports of a GitLab job: code quality, with one entry per problem, and the counts of a plan."""

import hashlib
from collections.abc import Iterable

from edgectl.errors import Problem
from edgectl.formats.document import Document, dump_line
from edgectl.model.plan import Action, Plan
from edgectl.views.encoder import encode_json


def render_report(problems: Iterable[Problem]) -> str:
    """The report; empty: ``[]``, which GitLab reads as "no problems"."""
    return encode_json([_build_entry(problem) for problem in problems])


def render_plan_counts(plan: Plan) -> str:
    """What a plan would start, change and stop, in the words of the widget for Terraform."""
    counts = {"create": 0, "update": 0, "delete": 0}
    for step in plan.steps:
        if step.changes:
            word = {Action.START: "create", Action.STOP: "delete"}.get(step.action, "update")
            counts[word] += 1
    return dump_line(counts) + "\n"


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
