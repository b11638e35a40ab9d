# SPDX-License-Identifier: Apache-2.0
"""Metadata of the distribution as its build backend reads them."""

import json
import os
import re
import subprocess
import sys
from typing import Any

from edgectl import __version__
from tests.views.fixtures import ROOT

BASE = "https://git.example.org/lab/edgectl/blob/v1"


def read_metadata(**env: str) -> dict[str, Any]:
    kept = {name: value for name, value in os.environ.items() if name != "EDGECTL_SOURCE_URL"}
    said = subprocess.run(
        [sys.executable, "-m", "hatchling", "metadata"],
        cwd=ROOT,
        env={**kept, **env},
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(said.stdout)
    return found


def list_links(text: str) -> list[str]:
    return re.findall(r"\]\(([^)]*)\)", text)


def test_links_lead_below_the_address_of_the_source() -> None:
    found = read_metadata(EDGECTL_SOURCE_URL=BASE + "/")
    links = list_links(found["readme"]["text"])
    assert len(links) >= 15
    own = [link.removeprefix(BASE + "/") for link in links]
    assert [link for link in own if not (ROOT / link.partition("#")[0]).exists()] == []
    assert found["urls"]["Changelog"] == f"{BASE}/docs/changelog.md"
    assert all((ROOT / url.removeprefix(BASE).lstrip("/")).exists() for url in found["urls"].values())


def test_without_an_address_nothing_leads_nowhere() -> None:
    found = read_metadata()
    assert list_links(found["readme"]["text"]) == []
    assert "## Know before you trust it" in found["readme"]["text"]
    assert not found.get("urls")
    assert (found["name"], found["version"]) == ("edgectl-robotics", __version__)
    assert found["authors"]
    assert len(found["keywords"]) >= 5
    assert {f"Programming Language :: Python :: 3.{minor}" for minor in (11, 12, 13, 14)} <= set(
        found["classifiers"]
    )
