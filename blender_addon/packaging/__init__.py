"""Builds the extension and its bill of materials; not part of the extension."""
