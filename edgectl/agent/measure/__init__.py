"""Profilers of device, network and tasks, and facts for ``edgectl doctor``."""
