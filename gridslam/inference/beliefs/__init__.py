"""The joint Gaussian of agents, clocks and lines: its layout, its particles, and what is known of anchors."""
