"""Speed and memory on this machine, against the plain twins."""
