"""Print a view of an experiment command in the format of ``-o``."""

import sys
from typing import Protocol

from edgectl.cli import console
from edgectl.formats.document import Document, dump_document
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import RenderOptions, detect_render_options


class View(Protocol):
    """The formats that every view has; some have ``wide(look)`` and ``markdown()`` too."""

    def table(self, look: RenderOptions = ...) -> str:
        """Text for people."""

    def document(self) -> Document:
        """The content as JSON types."""


def print_view(output: OutputFormat, view: View) -> None:
    """Print ``view`` on standard output. A view without a wide table prints its table."""
    console.print_text(render_view(output, view, detect_render_options(sys.stdout)))


def render_view(output: OutputFormat, view: View, look: RenderOptions) -> str:
    """``view`` in a format that it has: the option ``-o`` refuses the others."""
    if output is OutputFormat.JSON:
        return dump_document(view.document())
    if output is OutputFormat.YAML:
        from edgectl.views.yaml import yaml_from_json

        return yaml_from_json(dump_document(view.document()))
    if output is OutputFormat.MARKDOWN and hasattr(view, "markdown"):
        return str(view.markdown())
    if output is OutputFormat.WIDE and hasattr(view, "wide"):
        return str(view.wide(look))
    return view.table(look)
