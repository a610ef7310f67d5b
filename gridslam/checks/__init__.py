"""What a file is, and what is wrong with its units, frames or clocks."""
