# SPDX-License-Identifier: Apache-2.0
"""The agent: profilers of a host, its links and its tasks, and the supervisor of tasks.

Four rooms: ``link`` (request and reply), ``measure`` (profilers), ``supervise`` (start, supervision, state,
stop), ``daemon`` (resident profiler). Standard library only, psutil where importable, Python 3.6 and later,
and nothing of the rest of edgectl: the package is sent as one archive, cached under its hash, and imported as
``edgectl_agent``. ``link/first.py``, ``link/stub.py`` and ``link/boot.py`` are sent with every request.
"""
