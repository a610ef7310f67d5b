"""One mapping run, its record and its folder."""
