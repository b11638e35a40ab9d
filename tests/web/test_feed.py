# SPDX-License-Identifier: Apache-2.0
import threading
import time

from edgectl.formats.document import Document
from edgectl.web.feed import FleetFeed
from tests.pace import patience


def test_hosts_are_left_alone_while_nobody_looks() -> None:
    made: list[float] = []
    clock = [0.0]

    def make() -> Document:
        made.append(clock[0])
        return {}

    feed = FleetFeed(make, every=0.0, idle_s=60.0, now=lambda: clock[0])
    thread = threading.Thread(target=feed.run)
    thread.start()
    try:
        assert feed.wait_newer(3, patience(60)).number > 3
        clock[0] = 61.0
        time.sleep(0.2)
        # Only the round that had begun sees the new time.
        assert made.count(61.0) <= 1
        rested = len(made)
        asked = feed.wait_newer(rested, patience(60))
        assert asked.number > rested
        assert feed.describe(asked)["age_s"] == 0
    finally:
        feed.stop()
        thread.join(patience(60))
    assert not thread.is_alive()


def test_an_end_wakes_who_waits() -> None:
    feed = FleetFeed(dict, every=600.0)
    thread = threading.Thread(target=feed.wait_newer, args=(10, 600.0))
    thread.start()
    feed.stop()
    thread.join(patience(60))
    assert not thread.is_alive()
