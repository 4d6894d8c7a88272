"""State and background processes of the extension while Blender runs."""
