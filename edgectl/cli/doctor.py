"""doctor."""

from typing import Annotated

from typer import Argument, Exit

from edgectl.cli import console, exits, options
from edgectl.cli.complete import hosts as host_names
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def doctor_command(
    *,
    hosts: Annotated[
        list[str] | None, Argument(metavar="[HOST...]", autocompletion=host_names, help="Names in the inventory; all.", show_default=False)
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
    timeout: options.TimeoutOption = "15s",
) -> None:
    """Find what is wrong with this machine, the hosts and the ways between them, each with what mends it. Nothing is changed.

    Ends with 1 where a check failed; warnings alone end with 0.

    Examples:
        edgectl doctor
        edgectl doctor edge1 -o json
    """
    from edgectl.cli.reach import examined, seconds
    from edgectl.usecases.doctor import doctor

    loaded = load(inventory, tasks)
    fleet, state = examined(loaded)
    diagnosis = doctor(fleet, state, hosts or (), timeout=seconds(timeout, "--timeout"))
    console.show(output, "diagnosis", diagnosis)
    raise Exit(exits.of_diagnosis(diagnosis))
