"""Sweeps and bulk sets by many processes, their journal, budget and cluster jobs; without Blender itself."""
