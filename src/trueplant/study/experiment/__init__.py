"""The moves that would settle what is open."""
