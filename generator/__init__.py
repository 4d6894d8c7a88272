"""Build NLOS scenes in Blender, sweep a hidden object through its voxels and render what the wall shows."""
