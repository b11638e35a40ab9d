"""Owner of the project file and of its folder (ADR 139)."""

import os
from collections.abc import Collection
from pathlib import Path
from stat import S_ISDIR, S_ISVTX, S_IWGRP, S_IWOTH

from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.source import describe_exposure


def check_project_owner(path: Path, safe: Collection[Path], user_file: Path | None) -> None:
    """Refuse a project file that another user may have put there, as git refuses a repository of another
    user.

    Whoever writes it chooses the files that name commands. ``safe``: folders that ``user_file``, the user's
    configuration, trusts.

    Raises:
        InputError: another user owns or may write the file or its folder.
    """
    folder = path.parent
    if folder.resolve() in {each.resolve() for each in safe}:
        return
    problems = Problems()
    for place in (folder, path):
        exposure = _describe_place(place)
        if exposure is not None:
            start = Mark(Source(file=str(path), text="", lines=()), 0, 0)
            message, mend = exposure
            problems.add(
                start,
                ProblemCode.EXPOSED,
                f"not trusted: {'its folder: ' * (place == folder)}{message}",
                f"{mend}, or add it to safe_directories in {user_file or 'the user configuration'}: "
                f"{folder.resolve()}",
            )
            break
    problems.check()


def _describe_place(place: Path) -> tuple[str, str] | None:
    """Whoever else may write the place, and the remedy."""
    try:
        status, link = place.stat(), place.lstat()
    except OSError:
        return None  # said with its cause when it is read
    # In a sticky folder, such as /tmp, others may add files, but only its owner may exchange this one.
    shared = S_ISDIR(status.st_mode) and status.st_mode & S_ISVTX
    return describe_exposure(place, _without_shared_write(status) if shared else status) or (
        describe_exposure(place, _without_shared_write(link))
    )


def _without_shared_write(status: os.stat_result) -> os.stat_result:
    """For the owner alone: the permissions of a link mean nothing."""
    return os.stat_result((status.st_mode & ~(S_IWGRP | S_IWOTH), *status[1:]))
