"""ssim."""

from pathlib import Path
from typing import Annotated

from typer import Argument

from edgectl.cli import console, options
from edgectl.views.output_format import OutputFormat


def ssim_command(
    *,
    produced: Annotated[
        Path, Argument(metavar="MAP", help="The .yaml of a map, or its image: .pgm or .png.")
    ],
    truth: Annotated[Path, Argument(metavar="TRUTH", help="What it should look like.")],
    output: options.FieldsOutput = OutputFormat.TABLE,
) -> None:
    """Say how like the truth a map is: 1 where they are the same, lower the less alike (SSIM).

    Two .yaml files as map_server of ROS reads them are compared where they lie in the world, two images pixel by pixel. Needs the extra
    edgectl[evidence].

    Examples:
        edgectl ssim docs/examples/map.yaml docs/examples/world.yaml
        edgectl ssim docs/examples/map.yaml docs/examples/world.yaml -o json
    """
    from edgectl.cli.extras import require_extra

    with require_extra("evidence"):
        from edgectl.experiments.map_comparison import compare_maps, read_local_file

    console.print_view(output, "ssim", compare_maps(str(produced), read_local_file, truth))
