"""Classifiers of voxels, their evaluation and learning curves."""
