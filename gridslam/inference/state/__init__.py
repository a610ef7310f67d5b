"""The state and its parts, and the population of several states."""
