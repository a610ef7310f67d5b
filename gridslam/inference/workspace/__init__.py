"""What a filter writes to and may forget: buffers, particles and the clock of its steps."""
