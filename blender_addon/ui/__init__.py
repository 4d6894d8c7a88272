"""Settings, panels, menus and translations."""
