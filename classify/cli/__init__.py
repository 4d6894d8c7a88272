"""The command line ``nlos-classify``."""
