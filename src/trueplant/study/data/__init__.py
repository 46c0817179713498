"""The records as the analysis takes them, and what they show without a model of the plant."""
