# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch_yaml.launch_description_sources."""

from launch.launch_description_sources import YAMLLaunchDescriptionSource

__all__ = ["YAMLLaunchDescriptionSource"]
