"""What things are: scenes, voxels, settings, poses, on plain values. Knows no file format and no Blender."""
