# SPDX-License-Identifier: Apache-2.0
"""Types of what hosts report, with the bounds within which a report is believed."""

from typing import Annotated

from edgectl.agent.link import protocol
from edgectl.model.encoding import Bounds, Converted
from edgectl.model.text import clean_text

# An instant further back than ten years is no start of a task, and may lie before the first year.
_MAX_AGE_S = 10 * 366 * 86400.0

Text = Annotated[str, Converted(convert=clean_text)]
Age = Annotated[float, Bounds(maximum=_MAX_AGE_S)]
Generation = Annotated[int, Bounds(maximum=float(protocol.MAX_GENERATION))]
