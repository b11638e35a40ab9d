# SPDX-License-Identifier: Apache-2.0
"""The fixtures of the command line, for the commands of experiments."""

from tests.cli.conftest import run, site

__all__ = ["run", "site"]
