# SPDX-License-Identifier: Apache-2.0
"""Requests to all hosts at once, and their replies as values of the model."""
