"""What runs inside Blender: the only package that imports bpy."""
