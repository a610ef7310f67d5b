"""Where an agent began and which way it looks, and whether a filter only lost it."""
