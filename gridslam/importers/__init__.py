"""What other programs write (ray tracers, floor plans), as measurements or scenes."""
