"""The only room that imports bpy: what runs inside Blender."""
