"""Shell of the window: menus, shortcuts, command palette, theme, docks, messages."""
