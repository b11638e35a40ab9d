# SPDX-License-Identifier: Apache-2.0
"""The requests of a dry run: the command line and the standard input of each."""

import json
from collections.abc import Iterable, Mapping, Sequence

from edgectl.formats.document import Document
from edgectl.views.output import ListView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, RenderOptions, escape_unprintable, style_text


class RequestsView(ListView):
    """The requests that an apply would send, in order."""

    kind = "request"
    formats = ITEM_FORMATS

    def __init__(self, requests: Iterable[Mapping[str, object]]) -> None:
        self._requests = list(requests)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Of each request a heading, the command line and its standard input."""
        return "\n".join(_render_request(each, look) for each in self._requests)

    def notes(self) -> Sequence[str]:
        """That there are none."""
        return [] if self._requests else ["nothing to send"]

    def items(self) -> Sequence[Document]:
        """The requests as JSON types."""
        return [dict(each) for each in self._requests]


def _render_request(value: Mapping[str, object], look: RenderOptions) -> str:
    heading = style_text(f"# {value['host']}: {value['phase']} {value['task']}", "dim", look)
    stdin = json.dumps(value["stdin"], ensure_ascii=True)
    return f"{heading}\n{escape_unprintable(str(value['command']))}\n<<< {stdin}\n"
