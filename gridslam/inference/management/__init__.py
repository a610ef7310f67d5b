"""Hypotheses, their challengers, starts that aren't found yet, how agent and surfaces are held, parking,
merging and pruning, ghosts, recovery of a lost pose, what a step reports, estimates for users."""
