# SPDX-License-Identifier: Apache-2.0
"""The page in a real Chromium: make browser."""

import itertools
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import StateError
from edgectl.formats.document import Document
from tests.browser.chromium import Browser, run_browser
from tests.cli.inprocess import edgectl
from tests.pace import patience
from tests.web.servers import run_page_server

ROOT = Path(__file__).parents[2]
SHOTS = ROOT / "runs" / "browser"
# .ci/need-browser puts it there.
AXE = ROOT / ".venv" / "axe" / "axe.min.js"
HOSTS, TASKS, ROBOTS = 200, 500, 10
HOSTILE = "<img src=x onerror=alert(1)>\u202e\x1b[31m"
SHOWN = "document.documentElement?.dataset.version >= "


def a_task_row(number: int, round_: int) -> Document:
    """A row of the page; one in a hundred has failed."""
    failed = number % 100 == 7
    return {
        "task": f"task-{TASKS - number:03}", "host": f"edge{number % HOSTS:03}", "state": "failed" if failed else "ready",
        "age_s": 60.0 + round_, "attention": f"exit 1 {HOSTILE}" if failed else None, "action": "keep",
        "reason": "keep: still the best host", "managed": True, "restarts": 0,
        "cpu": {"used_cores": 0.1 + number % 7 / 10 + round_ / 100, "demand_cores": 0.5},
        "memory": {"used_bytes": 5e7 + round_ * 1e6, "demand_bytes": 1e8},
        "network": {"used_bytes_per_s": 1e5 * (round_ + 1), "demand_bytes_per_s": 2e6},
    }  # fmt: skip


def a_large_document(round_: int) -> Document:
    """200 hosts with 500 tasks and 2000 links, all of whose numbers differ from round to round."""
    phases = [
        {"phase": phase, "host": host, "duration_s": seconds, "ok": True}
        for phase, host, seconds in [
            ("hold", "robot1", 0.2),
            ("stop", "edge001", 1.1),
            ("start", "edge002", 0.4),
            ("ready", "edge002", 3.8),
        ]
    ]
    move = {
        "revision": 18, "started_at": "2026-11-23T04:53:41Z", "verb": "apply", "user": "ana", "task": "task-001", "action": "move",
        "outcome": "done", "host": "edge002", "previous_host": "edge001", "downtime_s": 5.3, "gap_s": 5.5, "phases": phases,
    }  # fmt: skip
    item = {
        "fleet": "lab", "taken_at": "2026-11-23T04:54:04Z", "problems": [f"edge003 does not answer: {HOSTILE}"],
        "changes": ["task-009: start: highest utility"], "plan_error": None,
        "tasks": [a_task_row(number, round_) for number in range(TASKS)],
        "hosts": [
            {"host": f"edge{number:03}", "role": "edge", "status": "unreachable", "error": HOSTILE, "silent_s": 75.0}
            if number == 3
            else {
                "host": f"edge{number:03}", "role": "edge", "status": "ok", "sample_age_s": 0.1,
                "cpu": {"used_cores": 1.0 + round_ / 10, "capacity_cores": 4.0, "reserved_cores": 2.5},
                "memory": {"used_bytes": 1e9, "capacity_bytes": 4e9, "reserved_bytes": 2e9},
                "task_names": [f"task-{TASKS - each:03}" for each in range(number, TASKS, HOSTS)],
            }
            for number in range(HOSTS)
        ],
        "links": [
            {
                "edge": f"edge{edge:03}", "robot": f"robot{robot}", "capacity_bytes_per_s": 1e7, "capacity_source": "declared",
                "used_bytes_per_s": 1e4 * edge + round_, "expected_bytes_per_s": 3e6, "rtt_ms": 2.5,
            }
            for edge in range(HOSTS) for robot in range(ROBOTS)
        ],
        "moves": [move] * 30,
    }  # fmt: skip
    return {"format_version": 2, "kind": "fleet-page", "item": item, "warnings": ["a note"]}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with run_browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


def list_complaints(browser: Browser) -> list[str]:
    """What the browser wrote into its log: exceptions, and what the content security policy stopped."""
    return [
        str(event["params"])
        for event in browser.events
        if event["method"] in ("Log.entryAdded", "Runtime.exceptionThrown", "Page.javascriptDialogOpening")
        # A page of a test before, whose server has ended.
        and "ERR_CONNECTION" not in str(event)
    ]


def list_names(browser: Browser, role: str) -> list[str]:
    """The names that a screen reader has for the elements of a role."""
    nodes: list[dict[str, Any]] = browser.call("Accessibility.getFullAXTree")["nodes"]
    return [
        node.get("name", {}).get("value", "")
        for node in nodes
        if node.get("role", {}).get("value") == role and not node.get("ignored")
    ]


TASK_EVENTS = ("RunTask", "ThreadControllerImpl::RunTask")


def sum_cpu_ms(
    events: list[dict[str, Any]], thread: tuple[int, int], begin_us: float, end_us: float
) -> float:
    """CPU time of a thread between two instants of the trace: of its tasks, which do not overlap."""
    return float(
        sum(
            event.get("tdur", 0)
            for event in events
            if event["ph"] == "X"
            and event["name"] in TASK_EVENTS
            and (event["pid"], event["tid"]) == thread
            and begin_us <= event["ts"] < end_us
        )
        / 1000
    )


def test_a_large_fleet_is_painted_and_updated_in_time(browser: Browser) -> None:
    """In CPU time of the page's thread, which other programs of the machine do not lengthen, and in the browser's own time."""
    rounds = itertools.count()
    with run_page_server(lambda: a_large_document(next(rounds)), every=1.0) as (made, feed):
        feed.wait_newer(0, 60)
        browser.resize(1280, 900)
        with browser.trace() as events:
            browser.open(f"http://127.0.0.1:{made.server_port}/")
            browser.wait_for(f"{SHOWN}1")
            browser.wait_for("performance.getEntriesByName('edgectl-update').length >= 8")
        updates = sorted(
            (event for event in events if event["name"] == "edgectl-update"), key=lambda event: event["ts"]
        )
        begins = [event for event in updates if event["ph"] == "b"]
        ends = [event for event in updates if event["ph"] == "e"]
        thread = (begins[0]["pid"], begins[0]["tid"])
        loaded = min(event["ts"] for event in events if event["name"] == "navigationStart")
        painted_us = min(
            event["ts"]
            for event in events
            if event["name"] == "Paint"
            and (event["pid"], event["tid"]) == thread
            and event["ts"] > ends[0]["ts"]
        )
        painted = sum_cpu_ms(events, thread, loaded, painted_us)
        # The update is one task of the thread, with nothing but its script.
        scripts = sorted(
            event.get("tdur", 0) / 1000
            for event in events
            if event["name"] in TASK_EVENTS
            and (event["pid"], event["tid"]) == thread
            and any(event["ts"] <= begin["ts"] <= event["ts"] + event.get("dur", 0) for begin in begins[1:])
        )
        values_ms = (painted_us - loaded) / 1000
        first_ms = browser.evaluate(
            "performance.getEntriesByType('paint').find(each => each.name === 'first-contentful-paint').startTime"
        )
        print(f"first contentful paint after {first_ms:.0f} ms of time")
        print(f"values painted after {painted:.0f} ms of CPU, {values_ms:.0f} ms of time")
        print(f"scripting of {len(begins) - 1} updates: {scripts[0]:.0f} to {scripts[-1]:.0f} ms of CPU")
        SHOTS.mkdir(parents=True, exist_ok=True)
        browser.save_screenshot(SHOTS / "large-1280.png")
        assert 0 < painted < 500
        assert 0 < first_ms < patience(500)
        assert 0 < scripts[len(scripts) // 2] < 50
        browser.wait_for(f"document.querySelectorAll('#tasks tbody tr').length === {TASKS}")
        assert browser.evaluate("document.querySelectorAll('#links tbody tr').length") == 40
    assert list_complaints(browser) == []


def a_small_document() -> Document:
    """The same of twenty hosts, for what looks at each element."""
    item: Any = a_large_document(0)["item"]
    return {
        **a_large_document(0),
        "item": {**item, "tasks": item["tasks"][:30], "hosts": item["hosts"][:20], "links": item["links"][:45], "moves": item["moves"][:3]},
    }  # fmt: skip


def run_axe(browser: Browser) -> None:
    """Names, roles, order of headings and contrast of the open page, by axe-core of the npm registry."""
    browser.evaluate(f"{AXE.read_text()}; 0")
    found = browser.evaluate(
        "axe.run().then(found => JSON.stringify({passes: found.passes.map(each => each.id), violations: "
        "found.violations.map(each => [each.id, each.impact, each.nodes.slice(0, 3).map(node => node.html + node.failureSummary)])}))"
    )
    report = json.loads(found)
    assert report["violations"] == []
    assert {"color-contrast", "page-has-heading-one"} <= set(report["passes"]), "nothing was judged"


SIZES = pytest.mark.parametrize(("width", "dark"), [(400, False), (400, True), (1280, False), (1280, True)])


@SIZES
def test_axe_finds_nothing(browser: Browser, width: int, dark: bool) -> None:
    with run_page_server(a_small_document, every=600) as (made, feed):
        feed.wait_newer(0, 60)
        browser.resize(width, 900, dark=dark)
        browser.open(f"http://127.0.0.1:{made.server_port}/")
        browser.wait_for(f"{SHOWN}1")
        run_axe(browser)


@SIZES
def test_a_report_fits_and_axe_finds_nothing(
    browser: Browser, width: int, dark: bool, tmp_path: Path
) -> None:
    page = tmp_path / "report.html"
    done = edgectl(["report", str(ROOT / "docs/examples/run"), "--out", str(page)], tmp_path, os.environ)
    assert done.code == 0, done.err
    browser.resize(width, 1400, dark=dark)
    browser.open(page.as_uri())
    browser.wait_for("document.readyState === 'complete'")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    SHOTS.mkdir(parents=True, exist_ok=True)
    name = f"report-{width}-{'dark' if dark else 'light'}"
    browser.save_screenshot(SHOTS / f"{name}.png")
    browser.evaluate("document.querySelector('figure').scrollIntoView()")
    browser.save_screenshot(SHOTS / f"{name}-figure.png")
    run_axe(browser)


@SIZES
def test_it_fits_and_shows_texts_of_hosts_as_text(browser: Browser, width: int, dark: bool) -> None:
    browser.events.clear()
    with run_page_server(lambda: a_large_document(0), every=600) as (made, feed):
        feed.wait_newer(0, 60)
        browser.resize(width, 1400, dark=dark)
        browser.open(f"http://127.0.0.1:{made.server_port}/")
        browser.wait_for(f"{SHOWN}1")
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        assert browser.evaluate("document.images.length") == 0
        text = browser.evaluate("document.querySelector('#problems').textContent")
        assert "<img src=x onerror=alert(1)>\\u202e\\u001b[31m" in text
        assert browser.evaluate("document.querySelector('#tasks tbody tr td').textContent") == "task-493", (
            "trouble first"
        )
        SHOTS.mkdir(parents=True, exist_ok=True)
        name = f"{width}-{'dark' if dark else 'light'}"
        browser.save_screenshot(SHOTS / f"{name}.png")
        browser.evaluate("document.querySelector('#links-title').scrollIntoView()")
        browser.save_screenshot(SHOTS / f"{name}-links.png")
        browser.evaluate("document.querySelector('#moves-title').scrollIntoView()")
        browser.save_screenshot(SHOTS / f"{name}-moves.png")
        assert list_complaints(browser) == []


def test_keyboard_and_screen_reader_reach_all_of_it(browser: Browser) -> None:
    with run_page_server(lambda: a_large_document(0), every=600) as (made, feed):
        feed.wait_newer(0, 60)
        browser.resize(1280, 900)
        browser.open(f"http://127.0.0.1:{made.server_port}/")
        browser.wait_for(f"{SHOWN}1")
        browser.call("Accessibility.enable")
        assert list_names(browser, "table") == ["Tasks", "Hosts", "Links"]
        assert list_names(browser, "searchbox") == ["Filter"]
        assert "Needs attention" in list_names(browser, "heading")
        assert all(list_names(browser, "button"))
        reached = []
        for _ in range(4):
            browser.press("Tab")
            reached.append(
                browser.evaluate(
                    "document.activeElement.className || document.activeElement.id || document.activeElement.tagName"
                )
            )
        assert reached == ["skip", "SUMMARY", "filter", "all-links"]
        browser.evaluate("document.querySelector('#filter').focus()")
        browser.call("Input.insertText", text="task-49")
        browser.wait_for("document.querySelector('#shown').textContent === '10 of 500 tasks'")


def test_it_says_that_values_are_old(browser: Browser) -> None:
    fails: list[bool] = []

    def make() -> Document:
        if fails:
            raise StateError("the disk is <full>")
        return a_large_document(0)

    with run_page_server(make, every=0.2) as (made, feed):
        feed.wait_newer(0, 60)
        browser.open(f"http://127.0.0.1:{made.server_port}/")
        browser.wait_for(f"{SHOWN}1")
        assert browser.evaluate("document.querySelector('#stale').hidden")
        fails.append(True)
        browser.wait_for(
            "document.querySelector('#stale').textContent.includes('The last probe failed: the disk is <full>.')"
        )
    browser.wait_for("document.querySelector('#stale').textContent.includes('No connection')")
    browser.wait_for(f"document.querySelectorAll('#tasks tbody tr').length === {TASKS}")


def test_a_token_is_asked_for_and_leaves_the_address(browser: Browser) -> None:
    token = "a-token-of-the-lab"
    with run_page_server(lambda: a_large_document(0), token=token, every=600) as (made, feed):
        feed.wait_newer(0, 60)
        url = f"http://127.0.0.1:{made.server_port}/"
        browser.open(url)
        browser.wait_for("document.activeElement && document.activeElement.id === 'token'")
        browser.call("Input.insertText", text=token)
        browser.evaluate("setTimeout(() => document.forms[0].requestSubmit()); 0")
        browser.wait_for(f"{SHOWN}1")
        assert browser.evaluate("location.href") == url
        assert browser.evaluate("document.cookie") == ""
