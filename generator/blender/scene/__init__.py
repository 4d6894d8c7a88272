"""The scene in Blender: its roles, building, opening and reading it, and moving the target."""
