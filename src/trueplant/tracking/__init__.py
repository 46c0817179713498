"""The plant followed through a long record, window by window."""
