# SPDX-License-Identifier: Apache-2.0
"""The HTML files of the page, each with the content security policy that lets only its own script and style
run.
"""

import base64
import hashlib
import re
from functools import cache
from importlib.resources import files

from edgectl.dataclass import dataclass

_INLINE = re.compile(r"<(script|style)>(.*?)</\1>", re.DOTALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """An HTML file and its ``Content-Security-Policy``."""

    body: bytes
    policy: str


@cache
def load_page(name: str) -> Page:
    """The page ``name`` (``fleet`` or ``login``)."""
    text = files("edgectl.web").joinpath(f"{name}.html").read_text(encoding="utf-8")
    return Page(body=text.encode(), policy=build_policy(text))


def build_policy(text: str) -> str:
    """Only what stands in the page runs, by its SHA-256; only this server is asked."""
    hashes: dict[str, list[str]] = {"script": [], "style": []}
    for kind, content in _INLINE.findall(text):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        hashes[kind].append(f"'sha256-{digest}'")
    allowed = {
        "default-src": "'none'",
        "script-src": " ".join(hashes["script"]) or "'none'",
        "style-src": " ".join(hashes["style"]) or "'none'",
        "img-src": "data:",
        "connect-src": "'self'",
        "base-uri": "'none'",
        "form-action": "'self'",
        "frame-ancestors": "'none'",
    }
    return "; ".join(f"{key} {value}" for key, value in allowed.items())
