"""Answers from the physics: atlas, posterior, detection, tracking and their bounds."""
