"""Evidence on one's own fleet: what other rules would have done, and what a model says of it. Pure; the scheduler is the real one."""
