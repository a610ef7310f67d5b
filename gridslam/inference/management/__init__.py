"""What keeps a belief in order: ghosts, recovery of a lost pose, readout."""
