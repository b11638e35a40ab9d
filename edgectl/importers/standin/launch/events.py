# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch.events."""

from _edgectl_recorder import Recorded, make_dropped


class Shutdown(Recorded):
    """The end of the launch."""


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)
