"""Networks: merging, lost agents, rival clocks, estimates for users."""
