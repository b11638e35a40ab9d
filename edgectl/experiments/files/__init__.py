"""Files of experiments: specs, scenarios, maps, run directories."""
