"""Files of experiments: specifications, scenarios, maps and runs."""
