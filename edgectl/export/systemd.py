# SPDX-License-Identifier: Apache-2.0
"""systemd units: a service with its timer for ``apply``, or one service for ``watch --apply``; text by file
name.
"""

import re

from edgectl.errors import UsageError
from edgectl.export.job import ScheduledJob, build_arguments, check_self_fence, format_interval

_DEFAULT_INTERVAL_S, _MIN_INTERVAL_S = 300.0, 1.0
# Exit codes that count as success beside 0: unreachable hosts (4) and a busy lock (75) are for the next run;
# 130 is an orderly stop.
_APPLY_SUCCESS_STATUSES, _WATCH_SUCCESS_STATUSES = "4 75 130", "4 130"
# Removes permissions that neither edgectl nor ssh needs. A user's systemd instance supports only the first
# five.
_HARDENING_SETTINGS = (
    "NoNewPrivileges=yes",
    "LockPersonality=yes",
    "RestrictRealtime=yes",
    "RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK",
    "SystemCallArchitectures=native",
    "ProtectSystem=full",
    "ProtectKernelModules=yes",
    "ProtectControlGroups=yes",
    "RestrictSUIDSGID=yes",
    "RestrictNamespaces=yes",
)
_USER_SETTINGS_COUNT = 5


def build_timer_units(job: ScheduledJob, *, user: bool) -> dict[str, str]:
    """Units that run ``apply`` periodically: a service and its timer. ``user``: for the user's systemd
    instance, else the system's.

    Raises:
        UsageError: a value cannot be quoted, or the interval is below a second.
    """
    every = _check_interval(_DEFAULT_INTERVAL_S if job.every_s is None else job.every_s)
    check_self_fence(job, every)
    name, title = build_unit_name(job), f"edgectl apply for {', '.join(job.inventories)}"
    service = [
        *_build_unit_section(title, user=user),
        "[Service]",
        "Type=oneshot",
        *_build_service_settings(job, ("apply", "--yes", "--quiet"), _APPLY_SUCCESS_STATUSES, user=user),
    ]
    timer = [
        "[Unit]",
        f"Description={_escape_specifiers(title)}, every {format_interval(every)}",
        "",
        "[Timer]",
        "# From the start of one run to the start of the next; runs do not overlap.",
        "OnActiveSec=10s",
        f"OnUnitActiveSec={every:.12g}s",
        "AccuracySec=1s",
        "",
        "[Install]",
        "WantedBy=timers.target",
    ]
    head = _list_install_comments(f"{name}.timer", user=user)
    return {
        f"{name}.service": _format_unit_file(f"{name}.service", head, service),
        f"{name}.timer": _format_unit_file(f"{name}.timer", head, timer),
    }


def build_watch_unit(job: ScheduledJob, *, user: bool) -> dict[str, str]:
    """Unit that runs ``watch --apply`` continuously.

    Raises:
        UsageError: a value cannot be quoted, or the interval is below a second.
    """
    name = f"{build_unit_name(job)}-watch"
    command = (
        ("watch", "--apply")
        if job.every_s is None
        else ("watch", "--apply", "--every", f"{_check_interval(job.every_s):.12g}s")
    )
    service = [
        *_build_unit_section(f"edgectl watch for {', '.join(job.inventories)}", user=user),
        "[Service]",
        "Type=exec",
        "# An invalid call or file (64) is not retried: it needs a correction first.",
        "Restart=always",
        "RestartSec=10s",
        "RestartPreventExitStatus=64",
        *_build_service_settings(job, command, _WATCH_SUCCESS_STATUSES, user=user),
        "",
        "[Install]",
        f"WantedBy={'default' if user else 'multi-user'}.target",
    ]
    return {
        f"{name}.service": _format_unit_file(
            f"{name}.service", _list_install_comments(f"{name}.service", user=user), service
        )
    }


def _check_interval(every_s: float) -> float:
    if every_s < _MIN_INTERVAL_S:
        raise UsageError(f"every {every_s:g}s is too short", hint="write 10s or more")
    return every_s


def build_unit_name(job: ScheduledJob) -> str:
    """The unit name without its suffix: letters, digits and ``:_.-``."""
    return "edgectl-" + re.sub(r"[^A-Za-z0-9:_.-]", "_", job.name)


def _build_unit_section(title: str, *, user: bool) -> list[str]:
    online = [] if user else ["Wants=network-online.target", "After=network-online.target"]
    return ["[Unit]", f"Description={_escape_specifiers(title)}", *online, ""]


def _build_service_settings(
    job: ScheduledJob, command: tuple[str, ...], ends: str, *, user: bool
) -> list[str]:
    arguments = build_arguments(job, *command)
    program, *rest = job.program
    line = " ".join(
        [
            quote_for_systemd(program),
            *(quote_for_systemd(word).replace("$", "$$") for word in (*rest, *arguments)),
        ]
    )
    return [
        *([] if user else [f"User={_escape_specifiers(job.user)}"]),
        f"WorkingDirectory={_escape_specifiers(job.directory)}",
        *(f"Environment={quote_for_systemd(f'{name}={value}')}" for name, value in job.environment.items()),
        f"ExecStart={line}",
        f"SuccessExitStatus={ends}",
        "# Only edgectl itself is stopped, after the running actions; tasks and their supervisors stay.",
        "KillMode=process",
        "TimeoutStopSec=2min",
        *_list_hardening_settings(job, user=user),
    ]


def _list_hardening_settings(job: ScheduledJob, *, user: bool) -> list[str]:
    if job.local:
        return ["# No sandbox: a host of this fleet is this machine, and its tasks would inherit it."]
    return [
        "# Not needed by edgectl and ssh. A password_command that uses sudo needs NoNewPrivileges=no.",
        *_HARDENING_SETTINGS[: _USER_SETTINGS_COUNT if user else None],
    ]


def _list_install_comments(unit: str, *, user: bool) -> list[str]:
    if user:
        return [
            "# Install: edgectl export systemd --user --out ~/.config/systemd/user ..",
            f"#          systemctl --user daemon-reload && systemctl --user enable --now {unit}",
            "#          loginctl enable-linger      (else it runs only while you are logged in)",
        ]
    return [
        "# Install: edgectl export systemd --out units .. && sudo cp units/* /etc/systemd/system/",
        f"#          sudo systemctl daemon-reload && sudo systemctl enable --now {unit}",
    ]


def _format_unit_file(name: str, head: list[str], lines: list[str]) -> str:
    return "\n".join([f"# {name}", *head, "", *lines]) + "\n"


def _escape_specifiers(text: str) -> str:
    """Escape specifiers in a value that systemd does not split into words."""
    return text.replace("%", "%%")


def quote_for_systemd(word: str) -> str:
    """Quote one word of a list where needed, with specifiers escaped."""
    if re.fullmatch(r"[A-Za-z0-9_@+=:,./-]+", word):
        return word
    return '"' + _escape_specifiers(word).replace('"', r"\"") + '"'
