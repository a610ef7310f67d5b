"""Maps: what an agent hands to the next, their files, frames and fusion."""
