"""The state directory of the fleet of an inventory file."""

from pathlib import Path

from edgectl.config.load import load_inventory
from edgectl.state.fleet_dir import ensure_fleet_dir


def open_fleet_dir(inventory: Path) -> Path:
    return ensure_fleet_dir(load_inventory(inventory).fleet, inventory)
