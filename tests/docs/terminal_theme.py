# SPDX-License-Identifier: Apache-2.0
"""Colours of the terminal in pictures of docs/screens: those of the dark page of edgectl serve."""

from rich.terminal_theme import TerminalTheme

THEME = TerminalTheme(
    (18, 22, 27),
    (230, 237, 243),
    [(72, 79, 88), (255, 123, 114), (74, 194, 107), (224, 165, 45), (88, 166, 255), (188, 140, 255), (57, 197, 207), (177, 186, 196)],
    [(110, 118, 129), (255, 161, 152), (86, 211, 100), (227, 179, 65), (121, 192, 255), (210, 168, 255), (86, 212, 221), (240, 246, 252)],
)  # fmt: skip
