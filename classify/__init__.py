"""Learn from pictures of the relay wall: features, classifiers, reports. Reads data sets, never Blender."""
