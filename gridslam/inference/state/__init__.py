"""The state and its parts, particles, rays, and the arrays of one anchor's measurements."""
