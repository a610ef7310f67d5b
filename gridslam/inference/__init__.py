"""Parts of the factor graph, shared by every system."""
