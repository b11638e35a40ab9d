# SPDX-License-Identifier: Apache-2.0
"""Algorithm 2: the diff of an assignment against the running tasks (pure), and its execution."""
