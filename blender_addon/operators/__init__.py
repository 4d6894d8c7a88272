"""Operators: thin wrappers around `generator`, grouped by panel."""
