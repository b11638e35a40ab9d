# SPDX-License-Identifier: Apache-2.0
"""State of the manager on disk: lock, journal, manager state, history; XDG paths."""
