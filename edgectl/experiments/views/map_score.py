# SPDX-License-Identifier: Apache-2.0
"""The score of a robot's map against ground truth."""

from edgectl.formats.document import Document
from edgectl.views.output import ItemView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, RenderOptions


class MapScoreView(ItemView):
    """Structural similarity (SSIM), -1..1; 1: equal."""

    kind = "map-score"
    formats = ITEM_FORMATS

    def __init__(self, ssim: float) -> None:
        self._ssim = ssim

    def table(self, look: RenderOptions = PLAIN) -> str:  # noqa: ARG002 - a number has one look
        """The number with four decimals."""
        return f"{self._ssim:.4f}\n"

    def item(self) -> Document:
        """The score as JSON types."""
        return {"ssim": self._ssim}
