"""Operators: thin, one file a panel."""
