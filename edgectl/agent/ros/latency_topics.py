# SPDX-License-Identifier: Apache-2.0
"""Latency of stamped messages: a process beside the tasks of this host listens to topics and counts ages.

A probe leaves the rules and reads the counts; the process ends when no probe has asked for a while.
"""

import _signal as signal
import os
import select
import time

from ..link import fast_json
from ..link.boot import make_private_dir
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure.latency import LatencyCounter, describe_error, load_counts, save_counts
from ..supervise import lockfile, records, spawn, state_dir, task_dirs
from .listener import TopicListener
from .local import fill_request

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

_FOLDER, _RULES = "latency-topics", "rules"
_MOST_RULES_BYTES = 1 << 20
# Without a probe for so long the process ends; a listener that ended is started again after a pause.
_LIFE_S, _RETRY_S = 600.0, 10.0
_TURN_S = 0.5
_UNSTAMPED = "messages of %s begin with no std_msgs/Header"


def read_topics(host: str, rules: "list[Document]") -> "dict[str, Document]":
    """Read task -> counts of its topic, and see to it that they are counted."""
    try:
        filled = [fill_request(rule) for rule in rules]
        folder = _make_folder(host)
        _write_rules(folder, filled)
        _ensure_process(folder)
    except (OSError, RefusalError) as error:
        why = getattr(error, "message", None) or str(error)
        return {str(rule["task"]): describe_error("no latency: %s" % why) for rule in rules}
    return {str(rule["task"]): _read_counts(folder, rule) for rule in filled}


def _make_folder(host: str) -> str:
    """Make the directory in the first base that accepts it. OSError where none does."""
    fault = OSError("no state directory")
    for levels in state_dir.list_host_dirs(host):
        folder = os.path.join(levels[-1], _FOLDER)
        try:
            for level in [*levels, folder]:
                make_private_dir(level)
            task_dirs.reserve_file(os.path.join(folder, "lock"), 0)
        except OSError as error:
            fault = error
        else:
            return folder
    raise fault


def _write_rules(folder: str, rules: "list[Document]") -> None:
    """Replace the rules where they differ; in any case they are as new as this probe."""
    path, text = os.path.join(folder, _RULES), fast_json.dumps({"rules": rules}).encode("ascii")
    if _read_file(path) == text:
        return os.utime(path)
    fd = records.open_private_file(path + ".new", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    try:
        os.write(fd, text)
    finally:
        os.close(fd)
    return os.rename(path + ".new", path)


def _read_file(path: str) -> bytes:
    try:
        fd = records.open_private_file(path, os.O_RDONLY)
    except OSError:
        return b""
    try:
        return os.pread(fd, _MOST_RULES_BYTES, 0)
    finally:
        os.close(fd)


def _get_task_folder(folder: str, rule: Document) -> str:
    return os.path.join(folder, state_dir.check_name(rule["task"]))


def _is_continued(known: Document, rule: Document) -> bool:
    """Whether the counts are of this topic and, as far as that is known, of this instance."""
    return known.get("topic") == rule["topic"] and rule["instance"] in ("", known.get("instance"))


def _read_counts(folder: str, rule: Document) -> Document:
    known = load_counts(_get_task_folder(folder, rule))
    counter = LatencyCounter(known if _is_continued(known, rule) else None)
    return dict(counter.describe(time.monotonic()), error=str(known.get("error") or ""))


def _ensure_process(folder: str) -> None:
    """Start the process where it does not live: it holds the lock while it does."""
    lock = lockfile.take_lock(folder)
    if lock < 0:
        return
    child = os.fork()
    if child == 0:
        _detach(folder, lock)
    os.close(lock)
    os.waitpid(child, 0)


def _detach(folder: str, lock: int) -> "NoReturn":
    """In the first child: a second one in a session of its own, which no login ends."""
    try:
        os.setsid()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if os.fork() == 0:
            spawn.clean_process((lock,))
            _TopicCounter(folder).run()
    finally:
        os._exit(0)


class _Source:
    """The listener to the topics of one ROS environment, and when it was started."""

    def __init__(self, rules: "list[Document]") -> None:
        version = int((rules[0].get("ros") or {}).get("version") or 1)
        topics = sorted({str(rule["topic"]) for rule in rules})
        self.listener, self.started = TopicListener(version, topics, rules[0]), time.monotonic()


class _TopicCounter:
    """The process that counts."""

    def __init__(self, folder: str) -> None:
        self.folder, self.seen = folder, -1
        self.rules: "list[Document]" = []
        self.sources: "dict[str, _Source]" = {}
        self.counters: "dict[str, LatencyCounter]" = {}
        self.saved: "dict[str, Document]" = {}
        self.unstamped: "dict[str, str]" = {}

    def run(self) -> None:
        """Count until no probe has asked for a while, or the directory is gone."""
        while self._take_rules():
            fds = [source.listener.fd for source in self.sources.values() if not source.listener.errors]
            select.select(fds, [], [], _TURN_S)
            for key, source in sorted(self.sources.items()):
                self._count(key, source)
            self._save()
            # Messages of half a second at once: the process wakes seldom, however many come.
            time.sleep(_TURN_S if fds else 0.0)
        for source in self.sources.values():
            source.listener.end()

    def _take_rules(self) -> bool:
        path = os.path.join(self.folder, _RULES)
        try:
            info = os.stat(path)
        except OSError:
            return False
        if info.st_ino != self.seen:
            self.seen = info.st_ino
            self.rules = fast_json.loads(_read_file(path).decode("ascii"))["rules"]
            self._adapt()
        return time.time() - info.st_mtime < _LIFE_S

    def _adapt(self) -> None:
        """Have the listeners and counters that the rules ask for."""
        grouped: "dict[str, list[Document]]" = {}
        for rule in self.rules:
            known = load_counts(_get_task_folder(self.folder, rule))
            kept = known if _is_continued(known, rule) else None
            self.counters[rule["task"]] = LatencyCounter(kept)
            grouped.setdefault(_build_key(rule), []).append(rule)
        for key, source in list(self.sources.items()):
            if key not in grouped or source.listener.topics != sorted({r["topic"] for r in grouped[key]}):
                self.sources.pop(key).listener.end()
        for key, rules in grouped.items():
            if key not in self.sources:
                self.sources[key] = _Source(rules)

    def _count(self, key: str, source: _Source) -> None:
        for topic, came, age in source.listener.read():
            for rule in self.rules:
                if rule["topic"] != topic or _build_key(rule) != key:
                    continue
                if age is None:
                    self.unstamped[topic] = _UNSTAMPED % topic
                else:
                    self.counters[rule["task"]].add(age, rule.get("bound_ms"), came)
        ended = time.monotonic() - source.started > _RETRY_S
        if source.listener.errors and ended:
            source.listener.end()
            self.sources[key] = _Source([rule for rule in self.rules if _build_key(rule) == key])

    def _save(self) -> None:
        for rule in self.rules:
            source = self.sources[_build_key(rule)]
            document = dict(
                self.counters[rule["task"]].save(),
                topic=rule["topic"],
                instance=rule["instance"],
                error=self.unstamped.get(rule["topic"]) or source.listener.errors.get(rule["topic"], ""),
            )
            if self.saved.get(rule["task"]) != document:
                make_private_dir(_get_task_folder(self.folder, rule))
                save_counts(_get_task_folder(self.folder, rule), document)
                self.saved[rule["task"]] = document


def _build_key(rule: Document) -> str:
    """What a listener depends on besides its topics."""
    return fast_json.dumps([rule.get("ros"), rule.get("env")])
