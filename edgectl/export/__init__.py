# SPDX-License-Identifier: Apache-2.0
"""Export for other programs: Prometheus, cron, systemd, CSV, JSON Lines."""
