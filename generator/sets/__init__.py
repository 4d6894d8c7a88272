"""Data sets, rendered and simulated: their fingerprints, and the interface by which both are read."""
