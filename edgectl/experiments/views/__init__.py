# SPDX-License-Identifier: Apache-2.0
"""One class per output of an experiment command: table, wide table, Markdown, document."""
