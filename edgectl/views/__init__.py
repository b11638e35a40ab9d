# SPDX-License-Identifier: Apache-2.0
"""Outputs: one class and one module for each thing that is shown."""
