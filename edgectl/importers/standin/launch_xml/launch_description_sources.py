# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch_xml.launch_description_sources."""

from launch.launch_description_sources import XMLLaunchDescriptionSource

__all__ = ["XMLLaunchDescriptionSource"]
