# SPDX-License-Identifier: Apache-2.0
"""Check of the state directory and its disk, here and on every host."""

from shlex import quote

from edgectl.model.diagnosis import NOT_A_DIRECTORY, Disk, Finding, Severity
from edgectl.units import format_bytes

# One task's log may take 30 MiB; below that a start is refused soon.
_FULL_BYTES, _SCARCE_BYTES = 50 * 2**20, 500 * 2**20
_FEW_FILES = 1000


def diagnose_disk(host: str | None, disk: Disk) -> Finding:
    """The state directory: whether it is usable, and the space left on its file system."""
    where = f"on {host}: " if host else ""
    if disk.obstacle:
        path = quote(disk.path)
        own = f"sudo mkdir -p {path} && sudo chown $(id -u) {path} && chmod 700 {path}"
        mend = where + (f"mv {path} {path}.old" if disk.obstacle == NOT_A_DIRECTORY else own)
        message = f"state directory {disk.path}: {disk.obstacle}" + (
            "; shared memory is used instead and is lost at a reboot" if disk.in_shared_memory else ""
        )
        return Finding(
            host=host,
            check="state",
            level=Severity.WARNING if disk.in_shared_memory else Severity.FAILED,
            message=message,
            remedy=mend,
        )
    if disk.skipped:
        paths = " ".join(quote(path) for path in disk.skipped)
        message = f"{paths}: made by another user, so it is skipped; there is no second place for tasks"
        return Finding(
            host=host,
            check="state",
            level=Severity.WARNING,
            message=message,
            remedy=f"{where}sudo rm -r {paths}",
        )
    scarce = disk.free_bytes < _SCARCE_BYTES
    few = disk.files_left is not None and disk.files_left < _FEW_FILES
    level = (
        Severity.FAILED
        if disk.free_bytes < _FULL_BYTES or few
        else Severity.WARNING
        if scarce
        else Severity.OK
    )
    left = f"{format_bytes(disk.free_bytes)} of {format_bytes(disk.total_bytes)} free for {disk.path}"
    message = f"{left}; only {disk.files_left} more files" if few else left
    mend = (
        f"{where}sudo journalctl --vacuum-size=100M; sudo apt-get clean; "
        "then: sudo du -xhd2 / | sort -h | tail"
    )
    return Finding(
        host=host, check="disk", level=level, message=message, remedy="" if level is Severity.OK else mend
    )
