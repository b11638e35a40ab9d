"""The SSIM of two maps, as text and as a document."""

from dataclasses import dataclass

from edgectl.formats.document import FORMAT_VERSION, Document, encode_number
from edgectl.views.text import PLAIN, RenderOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class SsimView:
    """The SSIM of a map and its ground truth, -1..1."""

    ssim: float

    def table(self, _look: RenderOptions = PLAIN) -> str:
        """The number with four decimals."""
        return f"{self.ssim:.4f}\n"

    def document(self) -> Document:
        """The number, unrounded."""
        return {"format_version": FORMAT_VERSION, "ssim": encode_number(self.ssim)}
