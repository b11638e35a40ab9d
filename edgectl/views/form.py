"""The forms of output, and how a form finds the function for what is shown."""

from collections.abc import Callable
from enum import StrEnum
from importlib import import_module
from typing import Any

from edgectl.errors import UsageError
from edgectl.model.names import either


class Form(StrEnum):
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


def forms_of(what: str) -> tuple[Form, ...]:
    """The forms in which ``what`` ("plan", "snapshot", ..) can be shown."""
    return tuple(form for form in Form if _function(form, what) is not None)


def view(form: Form, what: str) -> Callable[..., str]:
    """The function ``what`` of the form's module. Where nothing wider exists, wide is the table.

    Raises:
        UsageError: ``what`` has no such form.
    """
    function = _function(form, what) or (_function(Form.TABLE, what) if form is Form.WIDE else None)
    if function is None:
        raise UsageError(f"no {form} form of this", hint=f"write -o {either(forms_of(what))}")
    return function


def _function(form: Form, what: str) -> Callable[..., str] | None:
    module: Any = import_module(f"edgectl.views.{form}")
    return getattr(module, what, None)
