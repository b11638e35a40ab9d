"""What runs on a host: three profilers (device, network, task) and the supervisor of tasks.

Standard library only, psutil where importable, Python 3.6 and later, and nothing of the rest of edgectl: this package
travels as one zipapp, known by its hash, and is named ``edgectl_agent`` there. ``boot`` alone is sent with every request.
"""
