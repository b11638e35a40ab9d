"""Measure warm moves over real SSH between two computers in network namespaces, on links of 2 ms (root).

    .venv/bin/python -m tests.handoffs --moves 200

Prints the gap at the subscriber (p50, p95, p99, most) and how often two instances were active at once.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from edgectl.model.inventory import SshOptions
from tests.builders import an_edge, an_inventory
from tests.e2e.bench import a_slice, open_bench
from tests.handoffs.scene import Scene, a_node_task
from tests.handoffs.subscriber import count_overlaps, list_gaps_ms, listen

