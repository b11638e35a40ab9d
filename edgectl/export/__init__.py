"""Export for other programs: Prometheus, cron, systemd, CSV, JSON Lines."""
