# SPDX-License-Identifier: Apache-2.0
"""The read-only page of ``edgectl serve``: one probe loop, one HTML file, JSON and server-sent events."""
