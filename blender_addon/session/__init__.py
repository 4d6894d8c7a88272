"""What the extension knows while Blender runs: its state and its processes."""
