"""What is believed: agent and surfaces, rays, rings, and the arrays of one anchor's measurements."""
