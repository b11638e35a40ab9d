"""Crontab line that applies a fleet's tasks; without changes it prints nothing, so cron sends no mail."""

import shlex

from edgectl.errors import UsageError
from edgectl.export.job import ScheduledJob, build_arguments, check_self_fence, format_interval

# Limit of Vixie cron, whose daemon ignores longer commands.
_MAX_COMMAND_LENGTH = 998
_MINUTE, _HOUR, _DAY = 60, 3600, 86400
_DEFAULT_INTERVAL_S = 5 * _MINUTE


def format_crontab(job: ScheduledJob) -> str:
    """The line, below comments with installation instructions.

    Raises:
        UsageError: cron cannot express this interval, the line is too long for cron, or a value cannot be
        quoted.
    """
    every = _DEFAULT_INTERVAL_S if job.every_s is None else job.every_s
    check_self_fence(job, every)
    line = f"{format_cron_schedule(every)} {format_cron_command(job)}"
    return (
        f"# edgectl apply for {', '.join(job.inventories)}, every {format_interval(every)}.\n"
        "# Install: (crontab -l; edgectl export cron ..) | crontab -      Remove: crontab -e\n"
        "# cron mails the output: changes and failures. Without changes there is no output. Put\n"
        "# MAILTO=you@example.org above the line; for a file instead, append to the line: >> "
        "/path/to/edgectl.log 2>&1\n"
        f"{line}\n"
    )


def format_cron_schedule(every_s: float) -> str:
    """The five fields for an interval that divides an hour or a day evenly.

    Raises:
        UsageError: five fields cannot express it.
    """
    whole = int(every_s)
    if whole == every_s and whole >= _MINUTE:
        if whole < _HOUR and _HOUR % whole == 0 and whole % _MINUTE == 0:
            return f"*/{whole // _MINUTE} * * * *" if whole > _MINUTE else "* * * * *"
        if whole < _DAY and _DAY % whole == 0 and whole % _HOUR == 0:
            return f"0 */{whole // _HOUR} * * *" if whole > _HOUR else "0 * * * *"
        if whole == _DAY:
            return "0 0 * * *"
    said = format_interval(every_s)
    raise UsageError(
        f"cron cannot express every {said}",
        hint="use an interval that divides an hour or a day (5m, 15m, 1h, 6h), or edgectl export systemd",
    )


def format_cron_command(job: ScheduledJob) -> str:
    """The command for sh, quoted for a crontab.

    Raises:
        UsageError: it is too long, or cannot be quoted.
    """
    arguments = build_arguments(job, "apply", "--yes", "--quiet")
    variables = "".join(f"{name}={quote_for_cron(value)} " for name, value in job.environment.items())
    text = (
        f"cd {quote_for_cron(job.directory)} && "
        f"{variables}{' '.join(quote_for_cron(word) for word in (*job.program, *arguments))}"
    )
    if len(text) > _MAX_COMMAND_LENGTH:
        raise UsageError(
            f"the line has {len(text)} characters, cron takes at most {_MAX_COMMAND_LENGTH}",
            hint="shorten the paths, or use edgectl export systemd",
        )
    return text


def quote_for_cron(word: str) -> str:
    """Quote one word for sh, its percent signs outside of quotes: some crons remove the backslash before one,
    some leave it to sh.
    """
    return r"\%".join(shlex.quote(part) if part else "" for part in word.split("%")) or "''"
