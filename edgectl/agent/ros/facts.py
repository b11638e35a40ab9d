# SPDX-License-Identifier: Apache-2.0
"""Facts about ROS on this host, for ``edgectl doctor``."""

import os

from ..link.fast_json import Document
from ..measure import system_files
from . import local

_UP, _LOOPBACK, _MULTICAST = 0x1, 0x8, 0x1000
# Prints the packages of $EDGECTL_PACKAGES that are not found, as one line NAME=..
PACKAGES_VARIABLE = "EDGECTL_MISSING_PACKAGES"
FIND_PACKAGES = """_edgectl_missing=
for _edgectl_package in $EDGECTL_PACKAGES; do
  _edgectl_found=
  if [ -n "$AMENT_PREFIX_PATH" ]; then
    _edgectl_ifs=$IFS; IFS=:
    for _edgectl_prefix in $AMENT_PREFIX_PATH; do
      _edgectl_index=$_edgectl_prefix/share/ament_index/resource_index/packages
      [ -e "$_edgectl_index/$_edgectl_package" ] && _edgectl_found=1
    done
    IFS=$_edgectl_ifs
  else
    rospack find "$_edgectl_package" >/dev/null 2>&1 && _edgectl_found=1
  fi
  [ -n "$_edgectl_found" ] || _edgectl_missing="$_edgectl_missing $_edgectl_package"
done
echo "EDGECTL_MISSING_PACKAGES=$_edgectl_missing"
"""


def find_missing_files(ros: Document) -> "list[str]":
    """Find the set-up files that cannot be read."""
    return [path for path in ros["setup"] if not os.access(os.path.expanduser(path), os.R_OK)]


def read_ros_facts(ros: Document, links: "list[Document]") -> Document:
    """Read the facts of ROS but for the packages, which need its environment."""
    flags = _read_interface_flags()
    own = {
        str(link["robot"]): local.find_own_address([str(link["address"])])
        for link in links
        if local.resolve_addresses([str(link["address"])])
    }
    return {
        "missing_files": find_missing_files(ros),
        "addresses": own,
        "interfaces": sorted(flags),
        "no_multicast": sorted(name for name, flag in flags.items() if not flag & _MULTICAST),
        "receive_bytes": _read_number("/proc/sys/net/core/rmem_max"),
        "fragment_bytes": _read_number("/proc/sys/net/ipv4/ipfrag_high_thresh"),
    }


def _read_interface_flags(root: str = "/sys/class/net") -> "dict[str, int]":
    """Read name -> flags of the interfaces that are up, without the loopback one."""
    try:
        names = os.listdir(root)
    except OSError:
        return {}
    texts = {name: system_files.read_file("%s/%s/flags" % (root, name)) for name in names}
    found = {name: int(text, 16) for name, text in texts.items() if text.strip()}
    return {name: flag for name, flag in found.items() if flag & _UP and not flag & _LOOPBACK}


def _read_number(path: str) -> "float | None":
    text = system_files.read_file(path).strip()
    return float(text) if text.isdigit() else None
