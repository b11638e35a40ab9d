# SPDX-License-Identifier: Apache-2.0
"""Optional packages: imported on demand, with an install hint if missing.

The distribution is ``edgectl-robotics``: what package indexes call ``edgectl`` is another program. So a hint
names the source from which this edgectl was installed.
"""

import contextlib
import json
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from edgectl.errors import UsageError

DISTRIBUTION = "edgectl-robotics"
_CLONE = Path(__file__).parents[2]


@contextlib.contextmanager
def require_extra(name: str) -> Iterator[None]:
    """Import the packages of the extra ``name`` inside the block.

    Raises:
        UsageError: one of its packages is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "edgectl"):
            raise
        raise UsageError(
            f"this needs {missing}, which is not installed",
            hint=build_install_command(name, _read_origin(), Path(sys.prefix)),
        ) from None


def _read_origin() -> Mapping[str, Any] | None:
    """``direct_url.json`` of the installation; of the clone if it is not installed; None from an index."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        text = distribution(DISTRIBUTION).read_text("direct_url.json")
    except PackageNotFoundError:
        return {"url": _CLONE.as_uri(), "dir_info": {"editable": True}}
    found = json.loads(text) if text else None
    return found if isinstance(found, dict) and "url" in found else None


def build_install_command(extra: str, origin: Mapping[str, Any] | None, prefix: Path) -> str:
    """The command that installs the extra where edgectl is installed.

    ``origin`` is a direct_url.json, ``prefix`` the environment: one of uv's tools, of pipx, or any other.
    """
    needed = _build_requirement(extra, origin)
    editable = ["--editable"] if origin is not None and origin.get("dir_info", {}).get("editable") else []
    if (prefix / "uv-receipt.toml").exists():
        words = ["uv", "tool", "install", *editable, needed]
    elif (prefix / "pipx_metadata.json").exists():
        words = ["pipx", "install", "--force", *editable, needed]
    else:
        words = [str(prefix / "bin" / "python"), "-m", "pip", "install", *editable, needed]
    return shlex.join(words)


def _build_requirement(extra: str, origin: Mapping[str, Any] | None) -> str:
    """A directory with the extra, or the name with the extra and the URL."""
    from urllib.parse import unquote, urlsplit

    if origin is None:
        return f"{DISTRIBUTION}[{extra}]"
    url = str(origin["url"])
    if "dir_info" in origin:
        return f"{unquote(urlsplit(url).path)}[{extra}]"
    vcs = origin.get("vcs_info")
    if vcs:
        url = f"{vcs['vcs']}+{url}@{vcs.get('requested_revision') or vcs['commit_id']}"
    return f"{DISTRIBUTION}[{extra}] @ {url}"
