"""The command line ``nlos-generate``."""
