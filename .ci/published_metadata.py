# SPDX-License-Identifier: Apache-2.0
"""Metadata of the distribution that depend on where this source is published: README and addresses.

``EDGECTL_SOURCE_URL`` is the address below which the files of the release are shown, such as
https://git.example.org/lab/edgectl/blob/v0.1.0. Without it the README of a package index has no links.
"""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_RELATIVE_LINK = re.compile(r"\[([^\]]+)\]\((?![a-z]+:|#)([^)\s]+)\)")
_PAGES = {"Source": "", "Documentation": "/docs/index.md", "Changelog": "/docs/changelog.md"}


class PublishedMetadata(MetadataHookInterface):
    """The fields ``readme`` and ``urls``."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set both."""
        base = os.environ.get("EDGECTL_SOURCE_URL", "").rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        link = rf"[\1]({base}/\2)" if base else r"\1"
        metadata["readme"] = {"content-type": "text/markdown", "text": _RELATIVE_LINK.sub(link, text)}
        metadata["urls"] = {name: base + page for name, page in _PAGES.items()} if base else {}
