# SPDX-License-Identifier: Apache-2.0
"""Pictures of real runs in docs/screens: ``python -m tests.docs.screens``; with ``--demo`` the demo is recorded again.

Each SVG has the text of its screen as its description, for screen readers and for the test that compares it with a new run.
"""

import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

from rich.console import Console
from rich.text import Text

from edgectl.scaffold.write import write_scaffold
from tests.docs.blocks import environment
from tests.docs.cast_picture import render_cast
from tests.docs.recording import Recording, read_cast, record_program, write_cast
from tests.docs.terminal_theme import THEME
from tests.views.fixtures import ROOT, SNAPSHOT

SCREENS = ROOT / "docs" / "screens"
CAST = SCREENS / "demo.cast"
WIDTH = 100
# Rich's own form, without the fonts that it would load from elsewhere.
SVG_FORMAT = """\
<svg role="img" aria-labelledby="{unique_id}-title {unique_id}-desc" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<title id="{unique_id}-title">TITLE</title>
<desc id="{unique_id}-desc">DESCRIPTION</desc>
<style>
.{unique_id}-matrix {{ font-family: "DejaVu Sans Mono", Menlo, Consolas, monospace; font-size: {char_height}px; line-height: {line_height}px; }}
.{unique_id}-title {{ font-size: 16px; font-family: system-ui, "DejaVu Sans", sans-serif; }}
{styles}
</style>
<defs><clipPath id="{unique_id}-clip-terminal"><rect x="0" y="0" width="{terminal_width}" height="{terminal_height}" /></clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""


@dataclass(frozen=True, slots=True)
class Screen:
    """One picture: a command that contacts no host, or one of the demo."""

    name: str
    words: tuple[str, ...]
    prepare: Callable[[Path], object] | None = None


def break_a_demand(site: Path) -> None:
    file = site / "tasks" / "demo.yaml"
    text, count = re.subn(r"memory: 102Mi,", "memory: 102 megs,", file.read_text(), count=1)
    text, misspelt = re.subn(r"needs:", "need:", text, count=1)
    assert (count, misspelt) == (1, 1), "the shipped tasks have other demands"
    file.write_text(text)


# Run anew by the test: the same files give the same words.
OFFLINE = (
    Screen("plan", ("plan", "--snapshot", str(SNAPSHOT.relative_to(ROOT)))),
    Screen("explain", ("explain", "detection-robot3", "--snapshot", str(SNAPSHOT.relative_to(ROOT)))),
    Screen("validate", ("validate",), break_a_demand),
    Screen("experiment", ("experiment", "show", "docs/examples/run")),
)
# Taken from the recording of the demo.
LIVE = (
    Screen("apply", ("apply", "--yes")),
    Screen("status", ("status",)),
)


def record_offline(screen: Screen, folder: Path) -> str:
    """Run the command of a screen in a fleet of its own, on a terminal; its output."""
    site = folder / screen.name
    write_scaffold(site)
    (site / "docs").symlink_to(ROOT / "docs")
    if screen.prepare is not None:
        screen.prepare(site)
    env = {**environment(folder / "state"), "TERM": "xterm-256color", "LC_ALL": "C.UTF-8"}
    for name in ("NO_COLOR", "FORCE_COLOR", "NO_UNICODE", "COLUMNS"):
        env.pop(name, None)
    return record_program(["edgectl", *screen.words], cwd=site, env=env, width=WIDTH).text


def find_in_demo(screen: Screen, demo: Recording) -> str:
    """The output of a command of the demo: the first one."""
    _, _, rest = demo.text.partition(f"\n$ edgectl {' '.join(screen.words)}\n")
    output, _, _ = rest.partition("\n\n$ ")
    assert output, f"the demo has no {screen.words}"
    return output.partition("\n\n#")[0].strip("\n") + "\n"


def draw_screen(screen: Screen, output: str) -> str:
    """The SVG of a command and its output."""
    with Path(os.devnull).open("w") as nowhere:
        console = Console(record=True, width=WIDTH, file=nowhere, force_terminal=True, legacy_windows=False)
        command = f"$ edgectl {' '.join(screen.words)}\n"
        text = Text.from_ansi(command + output.rstrip("\n"))
        console.print(text, soft_wrap=False)
        described = escape(text.plain).replace("{", "{{").replace("}", "}}")
        form = SVG_FORMAT.replace("TITLE", f"edgectl {screen.words[0]}").replace("DESCRIPTION", described)
        drawn = console.export_svg(
            title=f"edgectl {screen.words[0]}",
            theme=THEME,
            code_format=form,
            unique_id=f"screen-{screen.name}",
        )
    return "\n".join(line.rstrip() for line in drawn.splitlines()) + "\n"


def read_description(svg: str) -> str:
    """The text of a screen, as its picture states it."""
    found = re.search(r"<desc[^>]*>(.*?)</desc>", svg, re.DOTALL)
    assert found is not None
    return found[1]


def mask_values(text: str) -> list[str]:
    """The lines of a screen without what differs from run to run: numbers with their units, paths, bars and widths."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", text)
    text = re.sub(r"(?<!\S)/\S*/edgectl-demo-\S+|/tmp/\S+|(?<=-)[0-9a-f]{6}\b", "X", text)
    text = re.sub(r"\d[\d.:,]*(?:[A-Za-z]+(?:/s)?\b|%)?", "0", text)
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


def outline_demo(text: str) -> list[str]:
    """The commands of the demo, what it tells, and the headings of its tables, in order."""
    heading = re.compile(r"[A-Z][A-Z0 %/,()-]*")
    return [line for line in mask_values(text) if line.startswith(("$ ", "# ")) or heading.fullmatch(line)]


def record_demo() -> Recording:
    """Run the demo on a terminal, with colours."""
    env = {
        **os.environ,
        "FORCE_COLOR": "1",
        "COLUMNS": str(WIDTH),
        "TERM": "xterm-256color",
        "LC_ALL": "C.UTF-8",
    }
    env.pop("NO_COLOR", None)
    # Messages without the progress that a terminal gets on standard error: it moves the cursor.
    script = 'set -o pipefail; exec 3>&1; "$0" -u -m tests.demo 2>&1 1>&3 | cat'
    found = record_program(["bash", "-c", script, sys.executable], cwd=ROOT, env=env, width=WIDTH)
    assert found.code == 0, found.text
    return found


def draw_all(folder: Path) -> Iterable[tuple[str, str]]:
    """Name and content of each picture."""
    for screen in OFFLINE:
        yield f"{screen.name}.svg", draw_screen(screen, record_offline(screen, folder))
    demo = read_cast(CAST)
    for screen in LIVE:
        yield f"{screen.name}.svg", draw_screen(screen, find_in_demo(screen, demo))
    yield "demo.svg", render_cast(demo)


def main() -> None:
    """Write the pictures, and with --demo the recording."""
    SCREENS.mkdir(exist_ok=True)
    if "--demo" in sys.argv[1:]:
        write_cast(record_demo(), CAST, title="make demo", idle_s=2.5)
    with tempfile.TemporaryDirectory() as folder:
        for name, content in draw_all(Path(folder)):
            (SCREENS / name).write_text(content)
            print(f"docs/screens/{name}: {len(content.encode()) / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
