# SPDX-License-Identifier: Apache-2.0
"""Soak test: resources of a long watch must not grow."""
