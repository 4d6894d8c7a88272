"""Settings, panels and menus."""
