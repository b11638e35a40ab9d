# SPDX-License-Identifier: Apache-2.0
"""Import of launch files and host lists of other tools: text to tasks and hosts. Callers read the files."""
