"""One file per published method: its time step as the list of the messages of its paper."""
