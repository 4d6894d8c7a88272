"""Data sets: rendered and simulated ones, their fingerprints, and what both offer to readers."""
