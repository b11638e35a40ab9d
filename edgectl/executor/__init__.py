"""Algorithm 2: the pure diff of an Assignment against what runs, and the run that carries it out."""
