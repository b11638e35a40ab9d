"""One JSON object per line, for programs that read as it comes."""

from edgectl.formats.base import dump_line
from edgectl.model.cycle import Cycle
from edgectl.views.rounds import document
from edgectl.views.text import PLAIN, Look


def cycle(value: Cycle, _look: Look = PLAIN) -> str:
    """One cycle of a watch."""
    return dump_line(document(value))
