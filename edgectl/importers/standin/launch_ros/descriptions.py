# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch_ros.descriptions."""

from _edgectl_recorder import Recorded

from launch_ros.parameter_descriptions import ParameterFile, ParameterValue


class ComposableNode(Recorded):
    """A component."""


__all__ = ["ComposableNode", "ParameterFile", "ParameterValue"]
