# SPDX-License-Identifier: Apache-2.0
"""Rules of nftables that count the bytes of each robot address, and the scripts that install and remove them
(ADR 104).

The rules are in a table of the fleet alone and only count: no packet is changed, dropped or accepted by them.
Both sides load this file: the agent runs the scripts, the manager prints them for an operator. Pure.
"""

import os

from ..link import protocol

# Where nft may be; sudo runs it by this path.
NFT_PATHS = ("/usr/sbin/nft", "/sbin/nft", "/usr/bin/nft", "/usr/local/sbin/nft")
# Counters by direction and protocol; ``other`` is UDP and all else.
TCP_IN, TCP_OUT, OTHER_IN, OTHER_OUT = "tcp_in", "tcp_out", "other_in", "other_out"
NAMES = (TCP_IN, TCP_OUT, OTHER_IN, OTHER_OUT)
# Sets by direction and family with the counts of each control group.
TASKS_IN, TASKS_OUT = "tasks_in", "tasks_out"
# Depths of a task's scope below the top of the control groups:
# user.slice/user-1000.slice/user@1000.service[/app.slice]/edgectl-HOST-TASK-0123abcd.scope.
SCOPE_LEVELS = (3, 4, 5, 6)
# Elements of a set: control groups on these levels times robots times protocols; a group that ended is
# dropped after this time without a packet.
_MAX_ELEMENTS, _FORGET = 65536, "1h"
# Before packets of one datagram are joined, and after their addresses were translated.
_FIRST, _LAST = -450, 450
_SUDOERS_FOLDER = "/etc/sudoers.d"


def get_table_name(fleet: str) -> str:
    """Get the name of the table of a fleet: names of fleets have no letters that nft would need escaped."""
    return "edgectl_" + fleet


def get_rules_file(fleet: str) -> str:
    """Get the path of the rules."""
    return protocol.COUNTERS_FILE % fleet


def build_name(counter: str, address: str) -> str:
    """Build the name of the counter of an address, in letters that nft accepts."""
    return "%s_%s" % (counter, address.replace(":", "-"))


def split_name(name: str) -> "tuple[str, str]":
    """Split the name of a counter into what it counts and the address."""
    first, second, address = name.split("_", 2)
    return "%s_%s" % (first, second), address.replace("-", ":")


def build_rules(fleet: str, addresses: "dict[str, list[str]]", *, tasks: bool) -> str:
    """Build the input of ``nft -f``: one transaction that replaces the table of the fleet and nothing else.

    ``tasks``: with the sets by control group, which needs Linux 5.13 and nft 0.9.9.
    """
    table = "table inet " + get_table_name(fleet)
    known = sorted({address for found in addresses.values() for address in found})
    by_family = {4: [each for each in known if ":" not in each], 6: [each for each in known if ":" in each]}
    lines = ["%s { }" % table, "delete " + table, table + " {"]
    lines += ["counter %s { }" % build_name(name, each) for name in NAMES for each in known]
    used = [family for family in (4, 6) if by_family[family]]
    if tasks:
        lines += [_build_set(name, family) for name in (TASKS_IN, TASKS_OUT) for family in used]
    for chain, hook, priority, names, end in (
        ("from_robots", "prerouting", _FIRST, (TCP_IN, OTHER_IN), "saddr"),
        ("to_robots", "postrouting", _LAST, (TCP_OUT, OTHER_OUT), "daddr"),
    ):
        rules = [
            _build_robot_rule(family, end, protocols, name, by_family[family])
            for family in used
            for protocols, name in zip(("== tcp", "!= tcp"), names)  # noqa: B905 - Python 3.6
        ]
        lines += _build_chain(chain, hook, priority, rules)
    for chain, hook, name, end in (
        ("to_tasks", "input", TASKS_IN, "saddr"),
        ("from_tasks", "output", TASKS_OUT, "daddr"),
    ):
        rules = [
            _build_task_rule(family, end, name, by_family[family], level)
            for family in used
            for level in SCOPE_LEVELS
        ]
        lines += _build_chain(chain, hook, _LAST, rules) if tasks else []
    return "\n".join([*lines, "}", ""])


def _build_set(name: str, family: int) -> str:
    return (
        "set %s%d { type ipv%d_addr . inet_proto . cgroupsv2; size %d; flags dynamic,timeout; timeout %s; "
        "counter; }" % (name, family, family, _MAX_ELEMENTS, _FORGET)
    )


def _build_chain(name: str, hook: str, priority: int, rules: "list[str]") -> "list[str]":
    head = "chain %s { type filter hook %s priority %d; policy accept;" % (name, hook, priority)
    return [head, *rules, "}"]


def _build_robot_rule(family: int, end: str, protocols: str, name: str, addresses: "list[str]") -> str:
    entries = ", ".join('%s : "%s"' % (each, build_name(name, each)) for each in addresses)
    return "meta l4proto %s counter name %s %s map { %s }" % (
        protocols,
        {4: "ip", 6: "ip6"}[family],
        end,
        entries,
    )


def _build_task_rule(family: int, end: str, name: str, addresses: "list[str]", level: int) -> str:
    field = "%s %s" % ({4: "ip", 6: "ip6"}[family], end)
    key = "%s . meta l4proto . socket cgroupv2 level %d" % (field, level)
    return "%s { %s } update @%s%d { %s }" % (field, ", ".join(addresses), name, family, key)


def build_install_script(fleet: str, addresses: "dict[str, list[str]]", nft: str, uid: int) -> str:
    """Build the shell script for root: rules into the kernel and a file, and for a user who is not root the
    sudoers file by which it may read these counters and load this file, and nothing else.

    ``nft``: one of NFT_PATHS; ``uid``: of that user. Without single quotes, so that it can be one word of a
    shell.
    """
    path = get_rules_file(fleet)
    lines = [
        "set -eu",
        "umask 022",
        "mkdir -p %s" % os.path.dirname(path),
        _write_file(path + ".tasks", build_rules(fleet, addresses, tasks=True)),
        _write_file(path + ".new", build_rules(fleet, addresses, tasks=False)),
        # Older kernels and nft cannot count by control group.
        "if %s -c -f %s.tasks 2>/dev/null; then mv -f %s.tasks %s.new; else rm -f %s.tasks; fi"
        % (nft, path, path, path, path),
        "%s -f %s.new || { rm -f %s.new; exit 1; }" % (nft, path, path),
        "mv -f %s.new %s" % (path, path),
    ]
    if uid != 0:
        lines += _build_sudoers_lines(fleet, nft, path, uid)
    return "\n".join(lines) + "\n"


def _write_file(path: str, text: str) -> str:
    return 'cat > %s <<"END"\n%sEND' % (path, text)


def _build_sudoers_lines(fleet: str, nft: str, path: str, uid: int) -> "list[str]":
    """Build the lines that write the sudoers file.

    It is checked before it is used, since a bad one disables sudo.
    """
    sudoers = _get_sudoers_file(fleet, uid)
    alias = "EDGECTL_%s_%d" % (fleet.encode().hex().upper(), uid)
    text = "\n".join(
        [
            "# Made by edgectl counters install: reading of the byte counters of fleet %s." % fleet,
            "Cmnd_Alias %s = %s list table inet %s, %s -f %s"
            % (alias, nft, get_table_name(fleet), nft, path),
            # Each probe runs one: no line in the log of the host, no session and no terminal for it.
            "Defaults!%s !syslog, !pam_session, !use_pty, !requiretty" % alias,
            "#%d ALL=(root) NOPASSWD: %s" % (uid, alias),
            "",
        ]
    )
    return [
        "umask 227",
        _write_file(sudoers + ".new", text),
        'visudo -c -q -f %s.new || { rm -f %s.new; echo "visudo refuses %s"; exit 1; }'
        % (sudoers, sudoers, sudoers),
        "mv -f %s.new %s" % (sudoers, sudoers),
    ]


def _get_sudoers_file(fleet: str, uid: int) -> str:
    """Get the path: sudo skips names with a dot."""
    return "%s/edgectl-%s-%d" % (_SUDOERS_FOLDER, fleet.replace(".", "__"), uid)


def build_remove_script(fleet: str, nft: str, uid: int) -> str:
    """Build the shell script for root that removes the table of the fleet, and the files beside it."""
    path = get_rules_file(fleet)
    table = "table inet %s" % get_table_name(fleet)
    lines = ["set -eu", "rm -f %s %s" % (path, _get_sudoers_file(fleet, uid))]
    if nft:
        # The first line makes the second one possible where the kernel has no such table.
        lines.append('printf "%%s\\n" "%s { }" "delete %s" | %s -f -' % (table, table, nft))
    lines.append("rmdir %s 2>/dev/null || true" % os.path.dirname(path))
    return "\n".join(lines) + "\n"
