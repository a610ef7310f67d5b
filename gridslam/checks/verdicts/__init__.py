"""All that may be wrong with a table, weighed against each other, and what is said of it."""
