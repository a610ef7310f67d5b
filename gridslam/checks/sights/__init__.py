"""Which rows are lines of sight, and where they put the agent: followed by a filter, or each row alone."""
