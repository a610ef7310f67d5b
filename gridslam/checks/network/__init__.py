"""Tables of several agents: labels, clocks, and each agent's rows."""
