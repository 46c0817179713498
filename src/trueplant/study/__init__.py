"""The analysis as one line (`pipeline`), and its stages."""
