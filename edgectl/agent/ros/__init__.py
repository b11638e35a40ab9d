# SPDX-License-Identifier: Apache-2.0
"""The ROS graph as this host sees it, and the addresses by which others see this host."""
