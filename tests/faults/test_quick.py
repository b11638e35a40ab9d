"""The short form of the fault matrix: the most important faults, once each, three at a time, on the best hosts that can be had here."""

import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from tests.faults import matrix
from tests.faults.fleet import How
from tests.faults.registry import Row, quick_cases, run

CASES = {each.name: (each, kind) for each, kind in quick_cases() if matrix.MODULES}


@pytest.fixture(scope="module")
def rows(request: pytest.FixtureRequest) -> Iterator[dict[str, "Future[Row]"]]:
    """What comes of each fault that was chosen."""
    chosen = {
        item.callspec.params["name"]
        for item in request.session.items
        if getattr(item, "originalname", "") == test_survived.__name__
    }
    with ThreadPoolExecutor(3) as pool:
        yield {
            name: pool.submit(run, *CASES[name], 1, 1, How(sample=True)) for name in CASES if name in chosen
        }
        pool.shutdown(cancel_futures=True)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", CASES)
def test_survived(rows: dict[str, "Future[Row]"], name: str) -> None:
    row = rows[name].result()
    if row.not_run:
        assert not (row.kind == "namespace" and os.geteuid() == 0), f"root, but {row.not_run}"
        pytest.skip(f"{name} ({row.kind}): not run: {row.not_run}")
    assert row.good, "\n".join(row.failures)
