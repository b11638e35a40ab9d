# SPDX-License-Identifier: Apache-2.0
"""Operation ``pull``: have the image of a task on this host, before anything is stopped for its sake.

Pulling takes minutes, a request only seconds: it goes on in a process of its own, and the manager asks again.
"""

import os
import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..supervise import lockfile, records, state_dir, task_dirs
from ..supervise.spawn import run_detached
from . import engine

# Nobody waits for longer, whatever the link.
_MAX_PULL_S = 3600.0
_LOCK_NAME, _FILE_NAME = "pull-lock", "pull"
_POLL_S = 0.1


def pull_image(request: Document) -> Document:
    """Pull the image where its policy asks for that; ``pulling`` is replied after ``timeout_s``.

    ``instance``: of which start it is the image; asked again with the same one, it is pulled once.

    Raises:
        RefusalError: there is no engine, no such image, or it is missing and must not be pulled.
    """
    image, token = request["image"], str(request["instance"])
    program = engine.choose_program(image.get("engine"))
    folder = task_dirs.make_task_dir(state_dir.check_name(request["host"]), request["task"])
    deadline = time.monotonic() + float(request["timeout_s"])
    if not _is_pulled(folder, token) and image["pull"] != "always" and _is_present(program, image):
        return {"state": protocol.PRESENT}
    while not _is_pulled(folder, token):
        lock = lockfile.take_lock(folder, _LOCK_NAME)
        if lock >= 0:
            _begin_pull(program, image, folder, token, lock)
        if time.monotonic() >= deadline:
            return {"state": protocol.PULLING}
        time.sleep(_POLL_S)
    return _build_pull_reply(folder, str(image["name"]))


def _is_pulled(folder: str, token: str) -> bool:
    return records.read_record(os.path.join(folder, _FILE_NAME)).get("instance") == token


def _is_present(program: str, image: Document) -> bool:
    """Whether the engine has the image.

    Raises:
        RefusalError: it does not answer, or has it not and must not pull.
    """
    call = engine.call_engine([program, "image", "inspect", "--format", "{{.Id}}", image["name"]])
    if call.kind == engine.DONE:
        return True
    if call.kind == engine.LOST or "permission denied" in call.why.lower():
        raise RefusalError(engine.NO_ENGINE, call.why, "edgectl doctor names what is missing there")
    if image["pull"] == "never":
        message = "the image %s is not on this host, and pull: never" % image["name"]
        raise RefusalError("no-image", message, "load it there, or write pull: missing")
    return False


def _begin_pull(program: str, image: Document, folder: str, token: str, lock: int) -> None:
    """Pull in a process of its own, which holds the lock."""

    def pull() -> None:
        call = engine.call_engine([program, "pull", "--quiet", image["name"]], _MAX_PULL_S)
        found = {"instance": token, "why": "" if call.kind == engine.DONE else call.why}
        records.write_record(os.path.join(folder, _FILE_NAME), found)

    null = os.open(os.devnull, os.O_WRONLY)
    run_detached(pull, null, (lock, null))
    os.close(lock)


def _build_pull_reply(folder: str, name: str) -> Document:
    why = records.read_record(os.path.join(folder, _FILE_NAME)).get("why")
    if why:
        message = "the image %s cannot be pulled: %s" % (name, why)
        raise RefusalError("no-image", message, "check its name, the registry, and docker login there")
    return {"state": protocol.PULLED}
