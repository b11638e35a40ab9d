"""systemd units: a service with its timer for ``apply``, or one service for ``watch --apply``. As plain text, by file name."""

import re

from edgectl.export.job import Job, interval, words

_DEFAULT_S, _SHORTEST_S = 300.0, 1.0
# What ends well beside 0: hosts that do not answer (4) and a busy lock (75) are for the next run; 130 is a stop in good order.
_APPLY_ENDS, _WATCH_ENDS = "4 75 130", "4 130"
# Takes rights away that neither edgectl nor ssh needs. Of these a user's own systemd can do the first five without more rights.
_HARDENING = (
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
_USERS_OWN = 5


def timer_units(job: Job, *, user: bool) -> dict[str, str]:
    """``apply`` every so often: a service and its timer. ``user``: for the user's own systemd, else for the system's.

    Raises:
        ValueError: what cannot be quoted, or an interval below a second.
    """
    every = _checked(_DEFAULT_S if job.every_s is None else job.every_s)
    name, title = unit_name(job), f"edgectl apply for {job.inventory}"
    service = [
        *_unit(title, user=user),
        "[Service]", "Type=oneshot", *_service(job, ("apply", "--yes", "--quiet"), _APPLY_ENDS, user=user),
    ]  # fmt: skip
    timer = [
        "[Unit]", f"Description={_plain(title)}, every {interval(every)}", "",
        "[Timer]",
        "# From the start of one run to the start of the next; a run that takes longer is not overtaken.",
        "OnActiveSec=10s", f"OnUnitActiveSec={every:.12g}s", "AccuracySec=1s", "",
        "[Install]", "WantedBy=timers.target",
    ]  # fmt: skip
    head = _installation(f"{name}.timer", user=user)
    return {f"{name}.service": _text(f"{name}.service", head, service), f"{name}.timer": _text(f"{name}.timer", head, timer)}


def watch_unit(job: Job, *, user: bool) -> dict[str, str]:
    """``watch --apply`` for as long as the machine runs.

    Raises:
        ValueError: what cannot be quoted, or an interval below a second.
    """
    name = f"{unit_name(job)}-watch"
    command = ("watch", "--apply") if job.every_s is None else ("watch", "--apply", "--every", f"{_checked(job.every_s):.12g}s")
    service = [
        *_unit(f"edgectl watch for {job.inventory}", user=user),
        "[Service]", "Type=exec",
        "# A call or a file that is wrong (64) stays wrong until somebody mends it.",
        "Restart=always", "RestartSec=10s", "RestartPreventExitStatus=64",
        *_service(job, command, _WATCH_ENDS, user=user),
        "", "[Install]", f"WantedBy={'default' if user else 'multi-user'}.target",
    ]  # fmt: skip
    return {f"{name}.service": _text(f"{name}.service", _installation(f"{name}.service", user=user), service)}


def _checked(every_s: float) -> float:
    if every_s < _SHORTEST_S:
        raise ValueError(f"every {every_s:g}s is too often; write 10s or more")
    return every_s


def unit_name(job: Job) -> str:
    """The name without its kind: letters, digits and ``:_.-`` are allowed."""
    return "edgectl-" + re.sub(r"[^A-Za-z0-9:_.-]", "_", job.name)


def _unit(title: str, *, user: bool) -> list[str]:
    online = [] if user else ["Wants=network-online.target", "After=network-online.target"]
    return ["[Unit]", f"Description={_plain(title)}", *online, ""]


def _service(job: Job, command: tuple[str, ...], ends: str, *, user: bool) -> list[str]:
    arguments = words(job, *command)
    program, *rest = job.program
    line = " ".join([quoted(program), *(quoted(word).replace("$", "$$") for word in (*rest, *arguments))])
    return [
        *([] if user else [f"User={_plain(job.user)}"]),
        f"WorkingDirectory={_plain(job.directory)}",
        *(f"Environment={quoted(f'{name}={value}')}" for name, value in job.environment.items()),
        f"ExecStart={line}",
        f"SuccessExitStatus={ends}",
        "# Only edgectl itself is stopped, and it finishes what is under way: tasks on this machine and their supervisors stay.",
        "KillMode=process", "TimeoutStopSec=2min",
        *_hardening(job, user=user),
    ]  # fmt: skip


def _hardening(job: Job, *, user: bool) -> list[str]:
    if job.local:
        return ["# No sandbox: a host of this fleet is this machine, and its tasks would inherit it."]
    return [
        "# What neither edgectl nor ssh needs. A password_command that uses sudo needs NoNewPrivileges=no.",
        *_HARDENING[: _USERS_OWN if user else None],
    ]


def _installation(unit: str, *, user: bool) -> list[str]:
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


def _text(name: str, head: list[str], lines: list[str]) -> str:
    return "\n".join([f"# {name}", *head, "", *lines]) + "\n"


def _plain(text: str) -> str:
    """A value that systemd does not split into words: only specifiers mean something in it."""
    return text.replace("%", "%%")


def quoted(word: str) -> str:
    """One word of a list: in quotes where it needs them, specifiers switched off."""
    if re.fullmatch(r"[A-Za-z0-9_@+=:,./-]+", word):
        return word
    return '"' + _plain(word).replace('"', r"\"") + '"'
