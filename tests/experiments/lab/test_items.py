# SPDX-License-Identifier: Apache-2.0
"""What one item takes is measured from the programs that run."""

from tests.experiments.lab.items import measure_cpu_ms


def test_a_picture_takes_more_than_its_making() -> None:
    """A picture is made by copying rows, and looked at pixel by pixel. Counters have ticks of 10 ms, so the making may show none."""
    looking, making = measure_cpu_ms("detection", "frame", 3.0)
    assert 0 <= making < looking < 1000
