# SPDX-License-Identifier: Apache-2.0
"""Grants of the fleet by this host, as every probe reports them; loaded without the rest of the lease."""

import os

from ..link import protocol
from ..link.boot import is_dir
from ..link.fast_json import Document
from . import records, state_dir

# One file for each manager that was granted the fleet.
LISTINGS = "manager-"


def read_grants(holder: str) -> Document:
    """To whom this host granted the fleet last, and the hosts of other managers than ``holder``.

    By it, a manager sees that others have acted, and where.
    """
    folders = [levels[-1] for levels in list_fleet_dirs()]
    found = [records.read_record("%s/%s" % (folder, protocol.LEASE_FILE)) for folder in folders]
    newest = max(found, key=lambda each: each.get("epoch", 0), default={})
    listings = [records.read_record(path) for path in list_listings(folders)]
    grants = {
        "holder": newest.get("holder", ""),
        "epoch": newest.get("epoch", 0),
        "other_epoch": newest.get("other_epoch", 0),
    }
    return dict(grants, **merge_listings(listings, holder))


def merge_listings(listings: "list[Document]", holder: object) -> Document:
    """The hosts that other managers than ``holder`` have, and the names of this machine among them."""
    others = [each for each in listings if each.get("holder") not in (None, holder)]
    return {key: sorted({name for each in others for name in each[key]}) for key in ("hosts", "names")}


def list_listings(folders: "list[str]") -> "list[str]":
    """List the files of the managers that were granted the fleet."""
    return [
        folder + "/" + name
        for folder in folders
        for name in (os.listdir(folder) if is_dir(folder) else ())
        if name.startswith(LISTINGS)
    ]


def list_fleet_dirs() -> "list[list[str]]":
    """List, for each base, the directories down to that of the fleet, which names of one machine share."""
    return [state_dir.list_fleet_levels(base) for base in state_dir.list_own_bases()]
