"""Inference from the physics: atlas, posterior, detection, tracking and their bounds."""
