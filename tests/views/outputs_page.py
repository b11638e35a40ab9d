# SPDX-License-Identifier: Apache-2.0
"""docs/reference/outputs.md: python -m tests.views.outputs_page > docs/reference/outputs.md"""

from edgectl.views.glossary import HEADINGS, list_keys

INTRODUCTION = """\
# Documents and columns

`-o json`, `-o yaml`, `-o jsonl` and `-o csv` print the same document.

- A list is `{format_version, kind, items, warnings}`, a single thing `{format_version, kind, item, warnings}`. `warnings` are the
  notes below the table. `plan` and `probe` print the plan and the snapshot file instead, which other commands read.
- An empty list prints nothing on standard output, and a note on standard error.
- `-o jsonl` prints one item per line, `-o csv` one item per row. In CSV the keys of an object are joined by `_`
  (`memory_used_bytes`) and a list is JSON.
- `edgectl schema KIND` prints the JSON Schema of a document, where KIND is its `kind`, as in `edgectl schema task-status`. The
  documents of `experiment` have `edgectl schema experiment-results`: `edgectl schema experiment` is that of the file.
- With `-w`, `-o json` prints one item per line as well; `watch -o jsonl` prints one cycle per line.
- A number has six significant digits at most, and its unit is in its name. A key has the same type everywhere; it is null or
  absent if its value is not known. Instants are RFC 3339. The keys of a `map` are names (of hosts, robots, resources ..).
"""


def render_outputs_page() -> str:
    """The page."""
    rows = [
        f"| `{entry.key}` | {entry.type.value} | {entry.unit or '-'} | {entry.meaning} |"
        for entry in list_keys()
    ]
    columns = [
        f"| {heading} | `{column}` |" for column, heading in sorted(HEADINGS.items(), key=lambda e: e[::-1])
    ]
    return "\n".join(
        [
            INTRODUCTION,
            "## Keys\n",
            "| key | type | unit | meaning |",
            "|---|---|---|---|",
            *rows,
            "",
            "## Headings of tables\n",
            "CPU below a tenth of a core is shown in thousandths: `3m`.\n",
            "| heading | quantity |",
            "|---|---|",
            *columns,
            "",
        ]
    )


if __name__ == "__main__":
    print(render_outputs_page(), end="")
