# SPDX-License-Identifier: Apache-2.0
"""Manual pages of all commands, made from the tree of commands that also makes their help."""

from collections.abc import Iterator
from typing import Any

from typer.main import get_command

from edgectl import __version__
from edgectl.cli.app import COMMANDS, EPILOG, GROUP_HELP, SUMMARY, build_app_with_commands
from edgectl.views.man_page import ManPage, render_man_page


def build_man_pages() -> dict[str, str]:
    """File name (``edgectl-plan.1``) -> page, of edgectl, its groups and its commands."""
    root = get_command(build_app_with_commands(list(COMMANDS)))
    codes, _, variables = EPILOG.partition("\n\n")
    notes = [
        ("EXIT STATUS", codes.partition(": ")[2]),
        ("ENVIRONMENT", variables.partition(": ")[2]),
    ]
    return {
        f"{page.name}.1": render_man_page(page, __version__, notes)
        for page in _walk(root, "edgectl", SUMMARY)
    }


def _walk(command: Any, words: str, summary: str) -> Iterator[ManPage]:  # noqa: ANN401 - typer has no public class of it
    inner = getattr(command, "commands", {})
    context = command.make_context("edgectl", [], resilient_parsing=True)
    context.info_name = words
    yield ManPage(
        words=words,
        summary=summary,
        usage=" ".join(command.get_usage(context).removeprefix("Usage:").split()),
        text=(command.help or summary).replace("\b", ""),
        options=_list_options(command, context, words, inner),
        examples=[line for line in (command.epilog or "").partition("Examples:\n")[2].splitlines() if line],
        others=_list_others(words, inner),
    )
    for name, each in inner.items():
        below = f"{words} {name}"
        path = below.removeprefix("edgectl ")
        yield from _walk(each, below, COMMANDS[path].help if path in COMMANDS else GROUP_HELP[path])


def _list_options(command: Any, context: Any, words: str, inner: Any) -> list[tuple[str, str]]:  # noqa: ANN401
    """Commands of a group, arguments and options, each with its meaning."""
    del words
    records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
    found = [(name, each.help or each.get_short_help_str(200)) for name, each in inner.items()]
    return [*found, *(record for record in records if record is not None)]


def _list_others(words: str, inner: Any) -> list[str]:  # noqa: ANN401
    up = words.replace(" ", "-").rpartition("-")[0]
    return [*([up] if up else []), *(f"{words.replace(' ', '-')}-{name}" for name in inner)]
