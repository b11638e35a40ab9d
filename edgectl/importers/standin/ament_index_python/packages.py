# SPDX-License-Identifier: Apache-2.0
"""Stand-in of ament_index_python.packages."""

from pathlib import Path

from _edgectl_recorder import get_package_directory


class PackageNotFoundError(KeyError):
    """A package is not installed; the stand-in never says so."""


def get_package_share_directory(package_name: str) -> str:
    """The share directory here, or a mark."""
    return get_package_directory(package_name, "share")


def get_package_share_path(package_name: str) -> Path:
    """The share directory here, or a mark."""
    return Path(get_package_directory(package_name, "share"))


def get_package_prefix(package_name: str) -> str:
    """A mark of the prefix."""
    return get_package_directory(package_name, "prefix")
