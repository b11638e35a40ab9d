"""One JSON object per line, for programs that read as it comes."""

from edgectl.formats.document import dump_line
from edgectl.model.cycle import Cycle
from edgectl.views.text import PLAIN, RenderOptions
from edgectl.views.watch_cycle import encode_cycle


def cycle(value: Cycle, _look: RenderOptions = PLAIN) -> str:
    """One cycle of a watch."""
    return dump_line(encode_cycle(value))
