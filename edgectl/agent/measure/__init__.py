# SPDX-License-Identifier: Apache-2.0
"""Profilers of device, network and tasks, and facts for ``edgectl doctor``."""
