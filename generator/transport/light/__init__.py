"""Light that is reflected more often, or comes from elsewhere than the lamp: over cells of the room's surfaces."""
