"""Around the panels: menus, shortcuts, command palette, theme, docks, messages."""
