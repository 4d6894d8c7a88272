"""Scenes, voxels, settings and poses as plain values, independent of file formats and of Blender."""
