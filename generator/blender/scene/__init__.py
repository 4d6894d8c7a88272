"""Blender scenes: the roles of objects; building, opening and reading a scene; moving the target."""
