"""Merging and pruning, ghosts, recovery of a lost pose, what a step reports, estimates for users."""
