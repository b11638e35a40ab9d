# SPDX-License-Identifier: Apache-2.0
"""Request path of the agent: boot program, dispatch, protocol, JSON, heartbeat."""
