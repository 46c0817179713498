"""What the plant means for today's loops, and better settings."""
