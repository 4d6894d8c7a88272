"""Measures costs, effects and their uncertainties, without Blender."""
