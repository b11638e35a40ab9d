# SPDX-License-Identifier: Apache-2.0
"""Stand-in of launch_ros.substitutions."""

from _edgectl_recorder import Context, Recorded, Substitution, get_package_directory, make_dropped, perform


class FindPackageShare(Substitution):
    """The share directory of a package."""

    KIND = "share"

    def perform(self, context: Context) -> str:
        """Its path here, or a mark."""
        package = self.words[0] if self.words else self.named["package"]
        return get_package_directory(perform(context, package), self.KIND)


class FindPackagePrefix(FindPackageShare):
    """The prefix of a package."""

    KIND = "prefix"


FindPackage = FindPackagePrefix


def __getattr__(name: str) -> type[Recorded]:
    return make_dropped(name)
