# SPDX-License-Identifier: Apache-2.0
"""The radios of this host."""

import os

from . import system_files

ROOT = ""


def list_radios() -> "list[str]":
    """List the wireless interfaces, by name."""
    try:
        return select_radios(sorted(os.listdir(ROOT + "/sys/class/net")))
    except OSError:
        return []


def select_radios(names: "list[str]") -> "list[str]":
    """Select the wireless ones of these interfaces."""
    folder = ROOT + "/sys/class/net"
    stated = system_files.read_file(ROOT + "/proc/net/wireless").decode("ascii", "replace").splitlines()[2:]
    listed = {line.partition(":")[0].strip() for line in stated}
    return [
        name
        for name in names
        if name in listed
        or os.access("%s/%s/wireless" % (folder, name), os.F_OK)
        or os.access("%s/%s/phy80211" % (folder, name), os.F_OK)
    ]
