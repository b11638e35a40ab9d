"""The forms of output, and how a form finds the function for what is shown."""

from collections.abc import Callable
from enum import StrEnum
from importlib import import_module
from typing import Any

from edgectl.errors import UsageError
from edgectl.names import format_alternatives


class OutputFormat(StrEnum):
    """What ``-o`` takes."""

    TABLE = "table"
    WIDE = "wide"
    JSON = "json"
    JSONL = "jsonl"
    YAML = "yaml"
    NAME = "name"
    MARKDOWN = "markdown"
    GITHUB = "github"
    MERMAID = "mermaid"
    DOT = "dot"


def list_output_formats(what: str) -> tuple[OutputFormat, ...]:
    """The forms in which ``what`` ("plan", "snapshot", ..) can be shown."""
    return tuple(form for form in OutputFormat if _find_renderer(form, what) is not None)


def get_renderer(form: OutputFormat, what: str) -> Callable[..., str]:
    """The function ``what`` of the form's module. Where nothing wider exists, wide is the table.

    Raises:
        UsageError: ``what`` has no such form.
    """
    function = _find_renderer(form, what) or (
        _find_renderer(OutputFormat.TABLE, what) if form is OutputFormat.WIDE else None
    )
    if function is None:
        raise UsageError(
            f"no {form} form of this", hint=f"write -o {format_alternatives(list_output_formats(what))}"
        )
    return function


def _find_renderer(form: OutputFormat, what: str) -> Callable[..., str] | None:
    module: Any = import_module(f"edgectl.views.{form}")
    return getattr(module, what, None)
