"""Messages of several agents, and of clocks that nobody set."""
