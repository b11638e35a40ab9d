# SPDX-License-Identifier: Apache-2.0
"""The command ssim."""

from pathlib import Path
from typing import Annotated

from typer import Argument

from edgectl.cli import console, options
from edgectl.views.output_format import OutputFormat


def ssim_command(
    *,
    produced: Annotated[
        Path, Argument(metavar="MAP", help="The map: a .yaml file, or an image (.pgm or .png).")
    ],
    truth: Annotated[Path, Argument(metavar="TRUTH", help="The ground truth, in the same form.")],
    output: options.ItemOutput = OutputFormat.TABLE,
) -> None:
    """Score a robot's map against ground truth (SSIM): 1 for identical maps, lower for less similar ones.

    Two .yaml files of ROS map_server are aligned by origin and resolution; two images are compared pixel by
    pixel. Requires the extra evidence.

    Examples:
        edgectl ssim docs/examples/map.yaml docs/examples/world.yaml
        edgectl ssim docs/examples/map.yaml docs/examples/world.yaml -o json
    """
    from edgectl.cli.extras import require_extra
    from edgectl.experiments.views.map_score import MapScoreView

    with require_extra("evidence"):
        from edgectl.experiments.map_comparison import compare_maps, read_local_file

    console.print_view(MapScoreView(compare_maps(str(produced), read_local_file, truth)), output)
