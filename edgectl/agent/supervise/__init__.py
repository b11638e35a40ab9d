# SPDX-License-Identifier: Apache-2.0
"""Start, supervision, state and end of tasks."""
