# SPDX-License-Identifier: Apache-2.0
"""The forms of output, and the ones that each kind of command offers."""

from collections.abc import Sequence
from enum import StrEnum

from edgectl.errors import UsageError
from edgectl.names import format_alternatives


class OutputFormat(StrEnum):
    """The values of ``-o``."""

    TABLE = "table"
    WIDE = "wide"
    JSON = "json"
    JSONL = "jsonl"
    YAML = "yaml"
    CSV = "csv"
    NAME = "name"
    MARKDOWN = "markdown"
    GITHUB = "github"
    GITLAB = "gitlab"
    MERMAID = "mermaid"
    DOT = "dot"


Formats = tuple[OutputFormat, ...]

# What people read.
HUMAN_FORMATS: Formats = (OutputFormat.TABLE, OutputFormat.WIDE)
# All derived from one document.
DOCUMENT_FORMATS: Formats = (OutputFormat.JSON, OutputFormat.JSONL, OutputFormat.YAML, OutputFormat.CSV)
ITEM_FORMATS: Formats = (OutputFormat.TABLE, *DOCUMENT_FORMATS)
WIDE_FORMATS: Formats = (OutputFormat.TABLE, OutputFormat.WIDE, *DOCUMENT_FORMATS)
NAMED_FORMATS: Formats = (*ITEM_FORMATS, OutputFormat.NAME)
FLEET_FORMATS: Formats = (*WIDE_FORMATS, OutputFormat.NAME)
EXPERIMENT_FORMATS: Formats = (*WIDE_FORMATS, OutputFormat.MARKDOWN)
PLAN_FORMATS: Formats = (*FLEET_FORMATS, OutputFormat.MARKDOWN, OutputFormat.GITLAB)
DIAGNOSIS_FORMATS: Formats = (*ITEM_FORMATS, OutputFormat.MARKDOWN)
VALIDATION_FORMATS: Formats = (*ITEM_FORMATS, OutputFormat.GITHUB, OutputFormat.GITLAB)
GRAPH_FORMATS: Formats = (OutputFormat.MERMAID, OutputFormat.DOT, *DOCUMENT_FORMATS)
CYCLE_FORMATS: Formats = (OutputFormat.TABLE, OutputFormat.JSONL)
# Of a list that is printed again and again.
STREAM_FORMATS: Formats = (OutputFormat.TABLE, OutputFormat.WIDE, OutputFormat.JSON, OutputFormat.JSONL)
NAMED_STREAM_FORMATS: Formats = (*STREAM_FORMATS, OutputFormat.NAME)


def is_supported(form: str, offered: Sequence[OutputFormat]) -> bool:
    """Whether ``form`` is one of ``offered``; ``wide`` is the table where nothing wider exists."""
    return form in offered or (form == OutputFormat.WIDE and OutputFormat.TABLE in offered)


def check_output_format(form: str, offered: Sequence[OutputFormat]) -> OutputFormat:
    """``form``, if it is one of ``offered``.

    Raises:
        UsageError: it is not.
    """
    if not is_supported(form, offered):
        raise UsageError(
            f'output format "{form}" is not supported here', hint=f"use -o {format_alternatives(offered)}"
        )
    return OutputFormat(form)
