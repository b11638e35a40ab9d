"""The line of a crontab that applies a fleet's tasks: it says nothing, and so sends no mail, where nothing had to be done."""

import shlex

from edgectl.export.job import Job, interval, words

# Of Vixie cron, whose daemon takes a longer command for none.
_LONGEST = 998
_MINUTE, _HOUR, _DAY = 60, 3600, 86400
_DEFAULT_S = 5 * _MINUTE


def crontab(job: Job) -> str:
    """The line, below comments that say how to install it.

    Raises:
        ValueError: cron cannot say this interval, or the line is longer than cron takes, or holds what cannot be quoted.
    """
    every = _DEFAULT_S if job.every_s is None else job.every_s
    line = f"{schedule(every)} {command(job)}"
    return (
        f"# edgectl apply for {job.inventory}, every {interval(every)}.\n"
        "# Install: (crontab -l; edgectl export cron ..) | crontab -      Remove: crontab -e\n"
        "# cron mails what is printed: what was done, and what failed. Nothing is printed where nothing had to be done. Put\n"
        "# MAILTO=you@example.org above the line; for a file instead, append to the line: >> /path/to/edgectl.log 2>&1\n"
        f"{line}\n"
    )


def schedule(every_s: float) -> str:
    """The five fields for an interval that divides an hour or a day evenly.

    Raises:
        ValueError: no five fields mean that.
    """
    whole = int(every_s)
    if whole == every_s and whole >= _MINUTE:
        if whole < _HOUR and _HOUR % whole == 0 and whole % _MINUTE == 0:
            return f"*/{whole // _MINUTE} * * * *" if whole > _MINUTE else "* * * * *"
        if whole < _DAY and _DAY % whole == 0 and whole % _HOUR == 0:
            return f"0 */{whole // _HOUR} * * *" if whole > _HOUR else "0 * * * *"
        if whole == _DAY:
            return "0 0 * * *"
    said = interval(every_s)
    raise ValueError(
        f"cron cannot say every {said}; write one that divides an hour or a day (5m, 15m, 1h, 6h), or use edgectl export systemd"
    )


def command(job: Job) -> str:
    """What sh is given, in the words of a crontab.

    Raises:
        ValueError: it is too long, or holds what cannot be quoted.
    """
    arguments = words(job, "apply", "--yes", "--quiet")
    variables = "".join(f"{name}={quoted(value)} " for name, value in job.environment.items())
    text = f"cd {quoted(job.directory)} && {variables}{' '.join(quoted(word) for word in (*job.program, *arguments))}"
    if len(text) > _LONGEST:
        raise ValueError(
            f"the line has {len(text)} characters, and cron takes {_LONGEST}; shorten the paths, or use edgectl export systemd"
        )
    return text


def quoted(word: str) -> str:
    """One word for sh, its percent signs outside of quotes: some crons take the backslash before one away and some leave it to sh."""
    return r"\%".join(shlex.quote(part) if part else "" for part in word.split("%")) or "''"
