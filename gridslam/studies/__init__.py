"""Monte Carlo studies: many runs, their tables and figures."""
