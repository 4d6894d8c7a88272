"""What nobody knows exactly of a room, fitted to measured pictures of it."""
