# SPDX-License-Identifier: Apache-2.0
"""Tasks in containers of a real Docker Engine."""
