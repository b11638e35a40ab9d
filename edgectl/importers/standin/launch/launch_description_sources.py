# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch.launch_description_sources."""

from typing import Any

from _edgectl_recorder import Recorded


class AnyLaunchDescriptionSource(Recorded):
    """A launch file of any kind."""

    @property
    def location(self) -> Any:  # noqa: ANN401
        """The path, which may be a substitution."""
        return self.words[0] if self.words else self.named["launch_file_path"]


PythonLaunchDescriptionSource = XMLLaunchDescriptionSource = AnyLaunchDescriptionSource
FrontendLaunchDescriptionSource = YAMLLaunchDescriptionSource = AnyLaunchDescriptionSource
