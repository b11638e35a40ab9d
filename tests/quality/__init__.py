"""Quality of plans: how far from the best ones, measured on generated fleets."""
