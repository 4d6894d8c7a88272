"""What costs what, what matters and how sure that is, without Blender."""
