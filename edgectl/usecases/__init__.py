# SPDX-License-Identifier: Apache-2.0
"""One module per command: wiring of ports, without rules of its own."""
