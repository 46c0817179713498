"""Other ways to the same answer, beside the fit."""
