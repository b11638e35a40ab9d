# SPDX-License-Identifier: Apache-2.0
"""Host keys, as the hosts show them and as known_hosts has them."""

from collections.abc import Sequence

from edgectl.formats.document import Document
from edgectl.model.host_key import HostKeyReport
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, render_columns

_HEAD = head("host", "key_type", "fingerprint", "state")
_STYLES = {"known": "good", "unknown": "warn"}


class HostKeysView(ListView):
    """One key of each host."""

    kind = "host-key"
    formats = NAMED_FORMATS

    def __init__(self, reports: Sequence[HostKeyReport]) -> None:
        self._reports = reports

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per host; empty where no host has a key."""
        rows = [
            (
                Cell(each.host, "name"),
                each.key_type or "-",
                each.fingerprint or "-",
                Cell(each.state, _STYLES.get(each.state, "bad")),
            )
            for each in self._reports
        ]
        return render_columns([_HEAD, *rows], look) if rows else ""

    def warnings(self) -> Sequence[str]:
        """Hosts that showed no key, or another one than is known; or that there is none to show."""
        if not self._reports:
            return ["no host here has a host key: all are this machine, or never contacted"]
        return [
            f"{each.host}: {each.error}" + (f"; {each.hint}" if each.hint else "")
            for each in self._reports
            if each.error
        ]

    def items(self) -> Sequence[Document]:
        """The keys as JSON types."""
        return [
            {
                "host": each.host,
                "key_type": each.key_type or None,
                "fingerprint": each.fingerprint or None,
                "state": each.state,
                "error": each.error or None,
                "hint": each.hint or None,
            }
            for each in self._reports
        ]

    def names(self) -> Sequence[str]:
        """The hosts, as host/NAME."""
        return [f"host/{each.host}" for each in self._reports]
