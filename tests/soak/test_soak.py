"""The short form of ``make soak``: a few hundred cycles must already grow nothing, and the gauge must see what does."""

import threading
from pathlib import Path

from tests.soak import fake, real
from tests.soak.gauge import TOLERANCE, grown, take
from tests.sshd import Lab


def test_the_gauge_sees_what_grows() -> None:
    before = take()
    kept = [object() for _ in range(10)], [[] for _ in range(TOLERANCE.objects + 100)]
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    with Path("/dev/null").open():
        after = take()
    over.set()
    thread.join()
    assert [each.split()[0] for each in grown(before, after)] == ["files", "threads", "objects"]
    assert len(kept) == 2
    assert grown(before, before) == []


def test_a_watch_over_simulated_hosts_grows_nothing() -> None:
    warm, end, counts = fake.soak(200, quiet=70, warm_at=0.5)
    assert grown(warm, end) == []
    assert counts["losses"] > 0
    assert counts["starts"] > len(fake.work().tasks)
    assert counts["errors"] == 0


def test_a_watch_over_real_hosts_of_which_one_dies_and_returns_grows_nothing(
    lab: Lab, tmp_path: Path
) -> None:
    warm, end, counts = real.soak(lab, tmp_path, 18, real.Rhythm(period=5, dead=3, quiet=10))
    assert grown(warm, end) == []
    assert (counts["losses"], counts["errors"], counts["left behind"]) == (1, 0, 0)
    assert counts["starts"] > 3, "what the dead host lost was started again"
