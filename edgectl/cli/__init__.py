# SPDX-License-Identifier: Apache-2.0
"""The command line: load, use case, view, exit code."""
