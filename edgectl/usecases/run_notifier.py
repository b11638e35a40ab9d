"""Program that calls a plugin of ``edgectl.notifiers`` with the events on standard input."""

import json
import sys

from edgectl.errors import EdgectlError
from edgectl.plugins import PluginGroup, load_plugin


def main() -> int:
    """Call the notifier that the first argument names; 1, and one line, if it fails."""
    document = json.load(sys.stdin)
    options = document.pop("options", {})
    try:
        load_plugin(PluginGroup.NOTIFIERS, sys.argv[1]).call(document, options)
    except EdgectlError as error:
        print(error.message)  # noqa: T201 - the courier reads the last line
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
